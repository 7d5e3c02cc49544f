"""What people do with an equilibrium: steer it to a target, read loads off measurements, fit a robot to them."""
