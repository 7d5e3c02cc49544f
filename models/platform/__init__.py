"""Several backbones that hold one platform: their boundary problem."""
