"""Health of a node: a sentence for people, values for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    """One diagnostic status: a sentence, and details for programs."""

    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)

    def with_warning(self, sentence: str) -> Health:
        """Return it with a further warning: beside what it says, or among the values if that is worse."""
        if self.level is Level.OK:
            return Health(Level.WARN, f"{self.message} {sentence}", self.values)
        return Health(self.level, self.message, {**self.values, f"also {len(self.values)}": sentence})

    @classmethod
    def of(cls, doing: str, observations: Sequence[Observation], values: Mapping[str, str]) -> Health:
        """Return a status of at most two sentences: what is under way, and the first of the most severe observations.

        ``doing`` is empty when the observation says it. The other observations become values.
        """
        ordered = sorted(observations, key=lambda observation: -observation[0])
        further = {f"also {number}": said for number, (_, said) in enumerate(ordered[1:], 1)}
        said = " ".join(filter(None, [doing, *(sentence for _, sentence in ordered[:1])]))
        level = ordered[0][0] if ordered else Level.OK
        return cls(level, said, {**values, **further})
