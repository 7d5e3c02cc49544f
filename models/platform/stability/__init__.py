"""The second variation of the energy of legs and platform, and what their residuals do work on."""
