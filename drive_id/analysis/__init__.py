"""Analysis of an identified map: torque, current trajectories, limits, losses, tables for control."""
