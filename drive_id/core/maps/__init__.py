"""What flux maps and inverter curves are made of: splines of flux and co-energy, coverage, continuation."""
