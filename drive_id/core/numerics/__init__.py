"""Numerics without drives: B-splines, compilation, normal equations, running sums, threads."""
