"""From sources (bags, information files, simulations) to a result."""
