"""docs/engineering/population.md: quantiles by family and effect, verdicts, the worst drives, those that got worse."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]
Verdicts = Mapping[tuple[int, str], set[str]]

VERDICTS = {
    "silent": "flux error above 0.3 % and 3 standard errors (rms over the map), and no warning",
    "silent R": "R off by more than 1 % and 3 standard errors, and no warning",
    "false warning": "no effects and a flux error below 0.2 %, but warned of something else than weak data",
    "wrong cause": "the warnings name causes, and none of them is in the drive",
    "false effect": "something was corrected that is not in the drive",
    "refused": "an error in place of a result",
    "crashed": "the process ended, or took more time than allowed",
}
QUANTILES = (0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
WORSE_SHARE, WORSE_POINTS = 0.1, 0.02
"""Growth of the flux error, relative and in percentage points, above which a drive counts as worse."""
_WORST = 10
_SHORT = 150


def flux_error(row: Row, method: str) -> float:
    """Return the larger error of the two fluxes, %; infinite without a map."""
    fit = row["fits"].get(method, {})
    return max(fit["psi_d"], fit["psi_q"]) if "psi_d" in fit else float("inf")


def page(rows: Sequence[Row], methods: Sequence[str], verdicts: Verdicts, command: str) -> Iterator[str]:
    """Yield the lines of the page."""
    simulated = [row for row in rows if "not_simulated" not in row]
    good = [row for row in simulated if row["well_posed"]]
    yield from (
        "# Population",
        "",
        f"Written by `{command}`:",
        f"{len(simulated)} random machines and drives, fitted with default settings and known pole pairs. Each machine",
        "is the gradient of a random co-energy, or rough measurements of one on a coarse grid; 4 to 1000 A, 1 to 20",
        "pole pairs, up to 3500 rpm, so slow that the current's ripple by the switching is at most a fifth of i_max.",
        "Half of the drives have no effect besides noise, inverter, rotor harmonics and",
        "ripple of the speed, three tenths have one effect, the others two or three, all at common magnitudes and",
        f"acting in the simulated machine. *Well posed* are {len(good)}, whose effects [limits](../limits.md) counts",
        "as identifiable. Flux errors are the larger NRMSE of the two fluxes over the map points with data, % of the",
        "largest true value; R: absolute error, %; band: share of points within their 95 % intervals; CPU: median, s.",
        'One drive alone: `make population ARGS="--only 17"`.',
        "",
        "## Verdicts",
        "",
        f"| verdict | {' | '.join(methods)} | drives of `{methods[0]}` |",
        "|---|" + "---:|" * len(methods) + "---|",
    )
    for verdict, meaning in VERDICTS.items():
        found = [[row["number"] for row in simulated if verdict in verdicts[row["number"], m]] for m in methods]
        numbers = ", ".join(map(str, found[0]))
        yield f"| {verdict}: {meaning} | {' | '.join(str(len(each)) for each in found)} | {numbers} |"
    for method in methods[1:]:
        pairs = [(row["number"], flux_error(row, method), flux_error(row, methods[0])) for row in simulated]
        losers = [number for number, its, ours in pairs if np.isfinite(ours) and _grown(its, ours)]
        yield f"| worse than `{method}` | {len(losers)} |{' |' * (len(methods) - 1)} {', '.join(map(str, losers))} |"
    families = {row["family"]: [r for r in good if r["family"] == row["family"]] for row in good}
    ordinary = [row for row in good if not row["effects"]]
    yield from ("", "## Families", "", "Well-posed drives.", "")
    yield from _table({"all": good, "without effects": ordinary, **families}, methods)
    names = sorted({name for row in simulated for name in row["effects"]})
    effects = {name: [row for row in simulated if name in row["effects"]] for name in names}
    yield from ("", "## Effects", "", "All drives that have the effect, others besides included.", "")
    yield from _table(effects, methods)
    yield from ("", "## The worst well-posed drives", "", "| drive | flux, % | R, % (z) | labels | report |")
    yield "|---|---:|---:|---|---|"
    for row in sorted(good, key=lambda row: -flux_error(row, methods[0]))[:_WORST]:
        yield _worst(row, methods[0], verdicts[row["number"], methods[0]])
    if missing := [str(row["number"]) for row in rows if "not_simulated" in row]:
        yield from ("", f"Not simulated, because the controller lost the currents: {', '.join(missing)}.")


def fresh(rows: Sequence[Row], methods: Sequence[str], verdicts: Verdicts) -> Iterator[str]:
    """Yield the lines on another seed, on whose drives no rule was judged."""
    simulated = [row for row in rows if "not_simulated" not in row]
    counts = {verdict: sum(verdict in verdicts[row["number"], methods[0]] for row in simulated) for verdict in VERDICTS}
    yield from ("", "## A seed on which no rule was judged", "")
    yield f"The same with `--count {len(rows)} --seed {rows[0]['seed']}`, put into this page by `--fresh`."
    yield f"Verdicts on `{methods[0]}`: {', '.join(f'{verdict} {count}' for verdict, count in counts.items())}."
    yield ""
    good = [row for row in simulated if row["well_posed"]]
    yield from _table({"all": good, "without effects": [row for row in good if not row["effects"]]}, methods)


def _table(groups: Mapping[str, Sequence[Row]], methods: Sequence[str]) -> Iterator[str]:
    heads = [*(f"{100 * q:g} %" if q < 1 else "max" for q in QUANTILES), "R 50 %", "R 95 %", "band", "CPU"]
    yield f"| drives | number | method | {' | '.join(heads)} |"
    yield "|---|---:|---|" + "---:|" * len(heads)
    for title, rows in groups.items():
        for method in methods:
            first = (title, str(len(rows))) if method == methods[0] else ("", "")
            yield f"| {' | '.join([*first, method, *_cells(rows, method)])} |"


def _cells(rows: Sequence[Row], method: str) -> Iterator[str]:
    if not rows:
        yield from ["–"] * (len(QUANTILES) + 4)
        return
    errors = [flux_error(row, method) for row in rows]
    fits = [row["fits"][method] for row in rows if "psi_d" in row["fits"].get(method, {})]
    for q in QUANTILES:
        value = float(np.quantile(errors, q, method="higher"))
        yield f"{value:.3f}" if np.isfinite(value) else "no map"
    if not fits:
        yield from ["–"] * 4
        return
    for q in (0.5, 0.95):
        yield f"{np.quantile([abs(fit['R']) for fit in fits], q):.2f}"
    yield f"{100 * np.mean([fit['band'] for fit in fits]):.0f} %"
    yield f"{np.median([fit['cpu'] for fit in fits]):.1f}"


def _worst(row: Row, method: str, verdicts: set[str]) -> str:
    fit = row["fits"].get(method, {})
    labels = [row["family"], *row["effects"], f"{row['i_max']:.3g} A", f"{row['pole_pairs']} pole pairs"]
    labels += [" and ".join(f"{speed:.0f}" for speed in row["speeds"]) + " rpm", f"noise {100 * row['noise']:.2f} %"]
    labels += [f"inverter {row['inverter']} {100 * row['inverter_width']:.1f} % wide"]
    labels += [f"bridge {100 * row['bridge'][0]:.0f} %, {100 * row['bridge'][1]:.1f} % wide"] if row["bridge"] else []
    labels += [f"{row['nodes']} nodes, {'' if row['reciprocal'] else 'not '}reciprocal"] if row["nodes"] else []
    labels += [f"excited to {100 * row['excitation']:.0f} %"] if row["excitation"] < 1 else []
    texts = [said["sentence"] for said in fit.get("warnings", ())]
    texts = texts or [each for each in (fit.get("refused"), row.get("lost")) if each]
    said = texts[0][:_SHORT].replace("|", "/").replace("\n", " ") if texts else "no warning"
    said += f" … (+{len(texts) - 1})" if len(texts) > 1 else ""
    flux = f"{fit['psi_d']:.3f} / {fit['psi_q']:.3f}" if "psi_d" in fit else "–"
    r = f"{fit['R']:+.1f} ({fit['R_z']:+.1f})" if "psi_d" in fit else "–"
    return f"| {row['number']} | {flux} | {r} | {', '.join(labels)} | {'; '.join([*sorted(verdicts), said])} |"


def _grown(then: float, now: float) -> bool:
    return now > (1 + WORSE_SHARE) * then and now > then + WORSE_POINTS


def worse(rows: Sequence[Row], old: Mapping[int, Row], methods: Sequence[str]) -> Iterator[str]:
    """Yield the drives whose flux error grew against an earlier output, and what became of all others."""
    for method in methods:
        pairs = [
            (row, flux_error(old[row["number"]], method), flux_error(row, method))
            for row in rows
            if method in old.get(row["number"], {}).get("fits", {}) and method in row["fits"]
        ]
        for row, then, now in pairs:
            if _grown(then, now):
                what = f"{row['family']} {','.join(row['effects'])}"
                yield f"Worse in {method}: {row['number']} ({what}), {then:.3f} % -> {now:.3f} %"
        counts = sum(_grown(then, now) for _, then, now in pairs), sum(_grown(now, then) for _, then, now in pairs)
        yield f"{method}: {counts[0]} of {len(pairs)} drives worse than before, {counts[1]} better."
