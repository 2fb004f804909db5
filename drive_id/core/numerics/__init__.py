"""Splines, kernels, threads, normal equations and running sums: no drive in here yet."""
