"""Live messages of one topic to signals, one message at a time."""

from __future__ import annotations

import numpy as np

from drive_id.core.signals.signal import SampleCount, Signal, block_stamps
from drive_id.errors import MessageTypeError, SamplePeriodError
from drive_id.files.messages.block_codec import LONGEST_PERIOD, decode_block
from drive_id.files.messages.messages import BLOCK_FIELDS


class BlockStream:
    """Decodes blocks of one of our sample messages on a topic, and counts lost samples."""

    def __init__(self, topic: str, type_name: str) -> None:
        self.topic = topic
        self.type_name = type_name
        self.count = SampleCount()
        self._fields = len(BLOCK_FIELDS[type_name])

    def decode(self, data: bytes) -> Signal:
        """Return the samples of one serialized message; those missing since the previous one are counted as lost.

        Raises MessageTypeError when it is not of this type, SamplePeriodError when its period is not positive, or
        absurdly long.
        """
        try:
            head, values = decode_block(data, self._fields)
        except ValueError as error:
            raise MessageTypeError(
                f"A message on {self.topic} cannot be read as {self.type_name} ({error}): correct its publisher."
            ) from error
        period = head.sample_period
        if not 0.0 < period < LONGEST_PERIOD:
            raise SamplePeriodError(
                f"A message on {self.topic} stamped {head.stamp} ns declares a sample period of {period} s: correct "
                "its publisher."
            )
        lost, losses = self.count.lost, self.count.losses
        self.count.add(head.first_sample, head.samples, head.stamp, period)
        return Signal(
            name=self.topic,
            stamp=block_stamps(head.stamp, head.samples, period),
            values=np.column_stack(values).astype(np.float64),
            sample_period=period,
            block_start=np.zeros(1, np.int64),
            lost=self.count.lost - lost,
            losses=self.count.losses - losses,
        )
