"""What a display of a running experiment shows, collected from topics: plain values, ready for JSON, without ROS."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drive_id.common.origins import ORIGINS
from drive_id.common.quantity import plain, scaled_unit
from drive_id.core.maps.flux_map import FluxMap

_MOST_POINTS = 2000
"""Points between two looks: 40 s of them."""
_SILENT = 5.0
"""Time without news, s, after which a node or the drive is called silent; each tells of itself every second."""
_I_MAX = "i_max [A]"
"""Name of the radius of the disc among the diagnostics of the publisher."""
_CELLS = 24
"""Cells of the coloured disc from zero to i_max."""
_WANTED = 0.01
"""Relative error of R, at 95 %, that is forecast."""
_Z = 1.96
"""Half of the 95 % interval of a normal distribution, by its standard deviation."""
_LEAST_GROWTH = 1.2
"""Ratio of samples between the two fits of a forecast: with less, their errors hardly differ."""
_MOST_GROWTH = 4.0
"""Ratio of the samples that a forecast needs to those there are: it reaches no further."""
_EXPONENTS = (0.3, 0.8)
"""Of the samples, with which a standard error falls that may be extrapolated: white noise has 0.5."""


@dataclass(frozen=True)
class ResistanceSoFar:
    """Resistance, ohm, from a number of samples, which arrived by ``time``, s of a steady clock."""

    time: float
    samples: int
    resistance: float
    sigma: float

    @property
    def error(self) -> float:
        """Half of the 95 % interval, relative."""
        return _Z * self.sigma / abs(self.resistance) if self.resistance else math.inf


def forecast(estimates: list[ResistanceSoFar], now: float) -> str:
    """Say when R will be within 1 % at 95 %; empty where its standard error does not fall as with white noise."""
    if not estimates:
        return ""
    last = estimates[-1]
    if last.error <= _WANTED:
        return f"R is within {100 * last.error:.2g} % (95 %)."
    before = [e for e in estimates if last.samples >= _LEAST_GROWTH * e.samples and last.time > e.time]
    if not before or not math.isfinite(last.error):
        return ""
    first = before[-1]
    exponent = math.log(first.error / last.error) / math.log(last.samples / first.samples)
    growth = (last.error / _WANTED) ** 2
    if not _EXPONENTS[0] <= exponent <= _EXPONENTS[1] or growth > _MOST_GROWTH:
        return ""
    rate = (last.samples - first.samples) / (last.time - first.time)
    missing = (growth - 1) * last.samples / rate - (now - last.time)
    return f"{missing:.0f} s more, and R is within 1 % (95 %)." if missing > 0 else ""


@dataclass
class LiveView:
    """Collects what arrives; :meth:`take` returns what is new, by topic. Not for several threads."""

    _points: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_MOST_POINTS))
    _new: dict[str, Any] = field(default_factory=dict)
    _estimates: list[ResistanceSoFar] = field(default_factory=list)
    _health: dict[str, Any] = field(default_factory=dict)
    _heard: dict[str, float] = field(default_factory=dict)
    _silent: list[str] = field(default_factory=list)
    _requested: bool = False  # the map is that of a requested fit, which holds until the next run

    def point(self, i_d: float, i_q: float, speed: float) -> None:
        """Take an operating point: A, electrical rad/s."""
        self._points.append((round(i_d, 3), round(i_q, 3)))
        self._new["speed"] = speed

    def state(self, name: str, values: dict[str, Any], time: float | None = None) -> None:
        """Take the present state of a node or of the drive, with the time, s, if it tells it again and again."""
        self._new[name] = plain(values)
        if name == "publisher" and values["state"] != "idle":
            self._requested = False
        if time is not None:
            self._heard[f"the {name}"] = time

    def health(self, node: str, level: int, message: str, values: dict[str, str], time: float) -> None:
        """Take a diagnostic status, with i_max of the publisher, and the estimate of R of the identification node."""
        self._health[node] = {"level": level, "message": message}
        self._heard[node] = time
        self._new["nodes"] = self._health
        if _I_MAX in values:
            self._new["i_max"] = float(values[_I_MAX])
        wanted = ("fit: samples", "fit: resistance [ohm]", "fit: sigma of resistance [ohm]")
        if not all(name in values for name in wanted):
            return
        samples, resistance, sigma = (float(values[name]) for name in wanted)
        found = ResistanceSoFar(time - float(values.get("fit: age [s]", 0.0)), int(samples), resistance, sigma)
        if self._estimates and found.samples < self._estimates[-1].samples:
            self._estimates.clear()  # another experiment
        if not self._estimates or found.samples > self._estimates[-1].samples:
            self._estimates.append(found)
        scale, unit = scaled_unit(abs(resistance), "Ω")
        told = [[e.samples, scale * e.resistance, scale * e.sigma] for e in self._estimates]
        self._new["resistance"] = plain({"estimates": told, "unit": unit, "forecast": forecast(self._estimates, time)})

    def flux_map(self, message: Any) -> None:
        """Take a map, an object with the fields of ``drive_id_msgs/FluxMap``: cells with data, and quantities.

        After a requested fit, the provisional maps of the same samples are left out until the next run.
        """
        if message.provisional and self._requested:
            return
        self._requested = not message.provisional
        axes = (np.asarray(message.i_d), np.asarray(message.i_q))
        turning = message.method not in ORIGINS or ORIGINS[message.method].turning
        names, shape = ("psi_d", "psi_q", "sigma_d", "sigma_q", "inside"), tuple(map(len, axes))
        found = FluxMap(*axes, *(np.asarray(getattr(message, name)).reshape(shape) for name in names))
        step = message.i_max / _CELLS
        k_d, k_q = (axis.ravel() for axis in np.mgrid[-_CELLS : _CELLS + 1, -_CELLS : _CELLS + 1])
        sigma = np.maximum(*found.sigma(step * k_d, step * k_q))
        known = np.isfinite(sigma)
        flux, flux_unit = scaled_unit(found.largest, "Wb")
        magnet = flux if turning else math.nan  # the magnets' flux of a locked rotor is unknown
        ohm, ohm_unit = scaled_unit(abs(message.resistance), "Ω")
        self._new["map"] = plain({
            "step": step, "i_max": message.i_max,
            "cells": np.stack([k_d, k_q], axis=-1)[known],
            "sigma": flux * sigma[known],
            "psi_pm": [*(magnet * float(x[0]) for x in (found.psi_dq(0.0, 0.0), found.sigma(0.0, 0.0))), flux_unit],
            "resistance": [ohm * message.resistance, ohm * message.sigma_resistance, ohm_unit],
            "drop": [message.voltage_error, message.sigma_voltage_error, "V"],
            "coverage": message.coverage, "provisional": message.provisional, "machine": message.machine,
            "method": message.method, "warnings": list(message.warnings),
        })  # fmt: skip

    def take(self, now: float = -math.inf) -> dict[str, Any]:
        """Return what is new since the last call, at a time, s; empty when nothing is."""
        silent = [f"Nothing is heard of {name} any more." for name, at in self._heard.items() if now > at + _SILENT]
        if silent != self._silent:
            self._silent = self._new["silent"] = silent
        found, self._new = self._new, {}
        if self._points:
            found["points"] = list(self._points)
            self._points.clear()
        return found
