"""One recorded signal, before it is joined with others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.errors import EmptyTopicError, NonFiniteError, StampOrderError
from drive_id.types import BoolArray, FloatArray, IntArray

LARGEST_CUT = 0.01
"""Largest part of a signal's samples that may be cut out for repeated or backward stamps."""


@dataclass(frozen=True, eq=False)
class Signal:
    """One recorded signal, in order of arrival.

    Parameters
    ----------
    name : str
        Its topic, for messages.
    stamp : (N,) int64
        ns.
    values : (N, K) float
        SI units.
    sample_period : float, optional
        As declared by its messages or its owner, s. ``None``: estimated from the stamps.
    block_start : (B,) int64, optional
        Index of the first sample of each message, beginning with 0. ``None``: one sample per message. The stamps in
        between follow from the declared period and thus say nothing about the true one.
    lost, losses : int
        Samples missing by the messages' own count, and the number of places where they are.
    """

    name: str
    stamp: IntArray
    values: FloatArray
    sample_period: float | None = None
    block_start: IntArray | None = None
    lost: int = 0
    losses: int = 0


@dataclass(frozen=True, eq=False)
class Ordered:
    """A signal without its repeated and backward stamps."""

    signal: Signal
    stamp: IntArray
    values: FloatArray
    repeated: int
    backward: int


def finite_rows(values: FloatArray) -> BoolArray:
    """Tell which rows of ``values`` (N, K) hold finite numbers only."""
    finite: BoolArray = np.all(np.isfinite(values), axis=1)
    return finite


def check_values(signal: Signal) -> None:
    """Refuse a signal without samples, or with samples that are not finite."""
    stamp, values = signal.stamp, signal.values
    if len(stamp) == 0:
        raise EmptyTopicError(f"{signal.name} holds no sample: record it, or name another topic.")
    finite = finite_rows(values)
    if not finite.all():
        k = int(np.argmin(finite))
        count = len(finite) - int(finite.sum())
        raise non_finite_error(signal.name, count, int(stamp[k]) - int(stamp.min()))


def in_order(signal: Signal) -> Ordered:
    """Cut out every sample whose stamp does not exceed all stamps before it."""
    stamp, values = signal.stamp, signal.values
    seen = np.maximum.accumulate(stamp)
    step = np.diff(stamp)
    repeated = (stamp[1:] == seen[:-1]) | (step == 0)
    behind = stamp[1:] <= seen[:-1]
    cut = int(behind.sum())
    if cut > LARGEST_CUT * len(stamp):
        k = int(np.argmax(behind)) + 1
        by, after = int(seen[k - 1]) - int(stamp[k]), int(stamp[k - 1]) - int(stamp[0])
        raise order_error(signal.name, cut, len(stamp), by, after)
    kept = np.concatenate(([True], ~behind))
    n_repeated = int(repeated.sum())
    return Ordered(signal, stamp[kept], values[kept], n_repeated, cut - n_repeated)


def non_finite_error(name: str, count: int, after: int) -> NonFiniteError:
    """Return the error for samples that are not finite, the first ``after`` ns behind the start."""
    return NonFiniteError(
        f"{name} holds {count} samples that are NaN or infinite, the first "
        f"{after * 1e-9:.6f} s after its start: cut the recording there or repair it."
    )


def order_error(name: str, cut: int, count: int, by: int, after: int) -> StampOrderError:
    """Return the error for stamps out of order, the first one by ``by`` ns, ``after`` ns behind the start."""
    return StampOrderError(
        f"{cut} of {count} stamps of {name} repeat or run backwards, the first by "
        f"{by * 1e-9:.6f} s at {after * 1e-9:.6f} s: "
        "check the clock of the publisher, or take another stamp source in a signals file."
    )
