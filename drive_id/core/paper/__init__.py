"""Methods ``psm`` and ``joint``: the paper's per-sample regression and its solution."""
