"""What joins rods and bodies: bodies, joints, rods that slide through holes, and where bodies then stand."""
