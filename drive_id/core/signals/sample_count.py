"""Following the running count of a topic's blocks, so that no sample is lost without a word."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class SampleCount:
    """Samples that came and samples that did not, by the count in the blocks.

    Parameters
    ----------
    samples : int
        Received.
    blocks : int
        Received.
    lost, losses : int
        Samples missing between blocks, and the number of places.
    restarts : int
        Places where the count ran backwards: the publisher began again, or there are two of them.
    """

    samples: int = 0
    blocks: int = 0
    lost: int = 0
    losses: int = 0
    restarts: int = 0
    _next: int | None = None

    def add(self, first_sample: int, samples: int) -> None:
        """Count one block of so many samples, the first of which is number ``first_sample``."""
        due = self._next
        if due is not None and first_sample != due:
            if first_sample > due:
                self.lost += first_sample - due
                self.losses += 1
            else:
                self.restarts += 1
        self._next = first_sample + samples
        self.samples += samples
        self.blocks += 1
