"""The error tree: each message is one line that says what is wrong, where, and what to do.

``code`` is the stable, machine-readable kind of error: services return it, ``--json`` prints it. Bad input raises
nothing but a :class:`DriveIdError`; any other exception is a bug in drive_id.
"""

from __future__ import annotations


class DriveIdError(Exception):
    """Base of all errors caused by bad input."""

    code = "error"

    def __init_subclass__(cls, code: str = "") -> None:
        """Set the code of a kind of error; without one, it is that of its base."""
        cls.code = code or cls.code


class ConfigurationError(DriveIdError, code="configuration"):
    """A parameter, option, signals file or machine file is invalid."""


class InactiveError(DriveIdError, code="inactive"):
    """A managed node is not active."""


class OutputError(DriveIdError, code="output"):
    """The output cannot be written (not ours to overwrite, no permission, disk full)."""


class InformationError(DriveIdError, code="information"):
    """Not an information file, damaged, or written by a newer version."""


class ResultError(DriveIdError, code="result"):
    """Not a result folder, damaged, or written by a newer version."""


class ExperimentError(DriveIdError, code="experiment"):
    """A node refuses, does not answer in time, or does not fit the others; ``code`` is that of the reply, if any."""

    def __init__(self, sentence: str, code: str = "") -> None:
        super().__init__(sentence)
        self.code = code or self.code


class WorkerError(DriveIdError, code="worker"):
    """A process that reads recordings has died."""


class BagError(DriveIdError, code="bag"):
    """Base of errors in a recording's container, found before any sample is read."""


class NotABagError(BagError, code="not_a_bag"):
    """The path is not a recording in a format that drive_id reads."""


class TruncatedBagError(BagError, code="truncated_bag"):
    """The recording is cut off (killed recorder, power loss, full disk) or damaged."""


class MissingTopicError(BagError, code="missing_topic"):
    """The bag has no topic for a required signal."""


class MessageTypeError(BagError, code="message_type"):
    """The type or the fields of a topic do not carry the signal."""


class EmptyTopicError(BagError, code="empty_topic"):
    """A required topic exists but holds no message or no sample."""


class MessageCountError(BagError, code="message_count"):
    """Fewer messages could be read than the bag itself declares."""


class DataError(DriveIdError, code="data"):
    """Base of errors in the samples themselves."""


class NonFiniteError(DataError, code="non_finite"):
    """Samples are NaN or infinite."""


class StampOrderError(DataError, code="stamp_order"):
    """Too many stamps repeat or run backwards."""


class SamplePeriodError(DataError, code="sample_period"):
    """Sample periods disagree: between signals, or between declaration and stamps."""


class NoOverlapError(DataError, code="no_overlap"):
    """The three signals overlap too little in time."""


class StandstillError(DataError, code="standstill"):
    """The machine hardly turns, so its flux induces no measurable voltage."""


class CoverageError(DataError, code="coverage"):
    """The data cover too little of the current plane for a map, or not the currents asked for."""


class DriveChangedError(DataError, code="drive_changed"):
    """The samples are of two drives, or of one before and after its restart: one map of both may be of neither."""


class UnexplainedError(DataError, code="unexplained"):
    """The fitted model leaves most of the voltage unexplained, so that its map means nothing."""
