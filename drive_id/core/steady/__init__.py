"""Method ``static``: maps, resistance and inverter drop from steady operating points of slow logs in d and q."""
