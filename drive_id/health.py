"""Health of a node: a sentence for people, values for programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class Level(IntEnum):
    """As in ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2


Observation = tuple[Level, str]
"""Severity of an observation, and a sentence about it."""


@dataclass(frozen=True)
class Health:
    """One diagnostic status.

    Parameters
    ----------
    level : Level
    message : str
        A sentence.
    values : mapping of str to str
        Details for programs.
    """

    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)
