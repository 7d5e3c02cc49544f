"""The second variation of one backbone's energy, and what its residuals do work on."""
