"""Driving a machine through its current plane: trajectories, reference limits, state machine, supervision."""
