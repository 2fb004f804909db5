"""Method ``static``: maps, resistance and inverter drop from operating points at rest, logged slowly in d and q."""
