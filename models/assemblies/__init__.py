"""The robots: one rod, concentric tubes, several backbones that hold a platform."""
