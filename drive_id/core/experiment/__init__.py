"""Driving a machine through its current plane: trajectories, limits, course and watch."""
