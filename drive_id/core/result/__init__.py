"""The identified drive: maps, resistance, inverter, standard errors and warnings."""
