"""Which experiment tells most: candidates, predicted standard errors, planner."""
