"""The second variation of a backbone's energy as a form of what is free at its tip, all else eliminated."""
