"""What follows from an identified map: torque, current trajectories, limits, losses, tables for control."""
