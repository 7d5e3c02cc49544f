"""What is behind measurements: loads and inputs, at once or in a loop, and the parameters of the robot itself."""
