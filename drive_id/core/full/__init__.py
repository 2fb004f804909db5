"""Method ``full``: windows in the stator frame, model selection, solution, noise correction, calibration."""
