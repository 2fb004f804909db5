"""Experiment design: settings, predicted standard errors, planner."""
