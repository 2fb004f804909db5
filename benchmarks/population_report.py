"""The page docs/population.md: quantiles by family and effect, verdicts, and the worst drives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]
Verdicts = Mapping[tuple[int, str], set[str]]

VERDICTS = (
    "silent", "silent R", "false warning", "wrong cause", "false effect", "refused", "crashed",
)  # fmt: skip
QUANTILES = (50, 75, 90, 95, 99, 100)
WORSE_SHARE, WORSE_POINTS = 0.1, 0.02
"""Growth of the flux error, relative and in percentage points, above which a drive counts as worse."""
_WORST = 10


def flux_error(row: Row, method: str) -> float:
    """Return the larger error of the two fluxes, %; infinite without a map."""
    fit = row["fits"].get(method, {})
    return max(fit["psi_d"], fit["psi_q"]) if "psi_d" in fit else float("inf")


def page(rows: Sequence[Row], methods: Sequence[str], verdicts: Verdicts, seed: int) -> Iterator[str]:
    """Yield the lines of the page."""
    rows = [row for row in rows if "not_simulated" not in row]
    yield f"# Population\n\n{len(rows)} drives, seed {seed}\n"
    good = [row for row in rows if row["well_posed"]]
    groups = {"all": rows, "well posed": good, "well posed, ordinary": [row for row in good if not row["effects"]]}
    groups |= {f"well posed, {name}": [r for r in good if r["family"] == name] for name in dict.fromkeys(r["family"] for r in good)}
    names = dict.fromkeys(name for row in rows for name in row["effects"])
    groups |= {name: [row for row in rows if name in row["effects"]] for name in names}
    yield "| drives | number | method | " + " | ".join(f"{q} %" for q in QUANTILES) + " | R 50 % | R 95 % | band |"
    yield "|---|---:|---|" + "---:|" * (len(QUANTILES) + 3)
    for title, chosen in groups.items():
        for method in methods:
            yield _row(title, chosen, method)
    yield "\n| verdict | " + " | ".join(methods) + " |"
    yield "|---|" + "---:|" * len(methods)
    for verdict in VERDICTS:
        yield f"| {verdict} | " + " | ".join(
            str(sum(verdict in verdicts[row["number"], method] for row in rows)) for method in methods
        ) + " |"


def _row(title: str, rows: Sequence[Row], method: str) -> str:
    errors = [flux_error(row, method) for row in rows]
    fits = [row["fits"][method] for row in rows if "psi_d" in row["fits"].get(method, {})]
    cells = [f"{np.quantile(errors, q / 100, method='lower'):.3f}" if errors else "–" for q in QUANTILES]
    r = [abs(fit["R"]) for fit in fits]
    cells += [f"{np.quantile(r, q):.1f}" if r else "–" for q in (0.5, 0.95)]
    cells.append(f"{100 * np.mean([fit['band'] for fit in fits]):.0f} %" if fits else "–")
    return f"| {title} | {len(rows)} | {method} | {' | '.join(cells)} |"


def worse(rows: Sequence[Row], old: Mapping[int, Row], methods: Sequence[str]) -> Iterator[str]:
    """Yield the drives whose flux error grew against an earlier output."""
    for method in methods:
        for row in rows:
            before = old.get(row["number"])
            if before is None or method not in before["fits"]:
                continue
            then, now = flux_error(before, method), flux_error(row, method)
            if now > (1 + WORSE_SHARE) * then and now > then + WORSE_POINTS:
                yield f"worse: {row['number']} {row['family']} {','.join(row['effects'])} {method} {then:.3f} -> {now:.3f} %"
