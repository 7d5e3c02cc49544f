"""The equations of one backbone: strains and rates along it, and conditions at its base and its tip."""
