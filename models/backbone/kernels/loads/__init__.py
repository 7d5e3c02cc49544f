"""What acts along the rods: dead loads, and loads that depend on the configuration."""
