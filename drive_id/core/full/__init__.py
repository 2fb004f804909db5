"""Method ``full``: windows in the stator frame, regression model, solver, model selection, fit, sensor calibration."""
