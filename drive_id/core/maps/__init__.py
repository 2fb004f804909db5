"""Flux maps and inverter curves: tensor and co-energy splines, shapes of the drop, coverage."""
