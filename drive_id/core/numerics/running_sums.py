"""What every sum over samples offers, so that it can be stored, restored and merged without knowing which one it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

State = dict[str, NDArray[Any]]
"""All that an accumulator has gathered, by name: plain arrays, scalars as arrays without axes."""

Self = TypeVar("Self", bound="Accumulator")


class Accumulator(Protocol):
    """Sums over samples whose size does not grow with their number."""

    def state(self) -> State:
        """Return all that was gathered; names hold no slash."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over the state of an accumulator that was constructed alike.

        Raises
        ------
        KeyError, ValueError, TypeError
            When the state is of another one.
        """

    def merge(self: Self, other: Self) -> None:
        """Add what another one, constructed alike, has gathered of other recordings; that one stays as it is."""


def prefixed(name: str, state: Mapping[str, NDArray[Any]]) -> State:
    """Return a state with its names below ``name``."""
    return {f"{name}/{key}": value for key, value in state.items()}


def below(name: str, state: Mapping[str, NDArray[Any]]) -> State:
    """Return the part of a state that :func:`prefixed` put below ``name``."""
    return {key.removeprefix(f"{name}/"): value for key, value in state.items() if key.startswith(f"{name}/")}


def exactly(value: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of an array that was read, if it has the shape and the kind of numbers of ``like``.

    Raises
    ------
    ValueError
        When it has not.
    """
    if value.shape != like.shape or value.dtype != like.dtype:
        raise ValueError(f"{value.dtype}{value.shape} where {like.dtype}{like.shape} is needed")
    return np.array(value)
