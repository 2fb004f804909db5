"""The error tree: each message is one sentence that says what is wrong, where, and what to do.

``code`` is the stable, machine-readable kind of error: services return it, ``--json`` prints it. Bad input raises
nothing but a :class:`DriveIdError`; any other exception is a bug in drive_id.
"""

from __future__ import annotations


class DriveIdError(Exception):
    """Base of all errors caused by bad input."""

    code = "error"


class ConfigurationError(DriveIdError):
    """A parameter, option, signals file or machine file is invalid."""

    code = "configuration"


class InactiveError(DriveIdError):
    """A managed node is not active."""

    code = "inactive"


class OutputError(DriveIdError):
    """The output cannot be written (not ours to overwrite, no permission, disk full)."""

    code = "output"


class InformationError(DriveIdError):
    """Not an information file, damaged, or written by a newer version."""

    code = "information"


class ResultError(DriveIdError):
    """Not a result folder, damaged, or written by a newer version."""

    code = "result"


class ExperimentError(DriveIdError):
    """A node refuses, does not answer in time, or does not fit the others."""

    code = "experiment"


class ClusterError(DriveIdError):
    """The Dask cluster cannot be reached, or was lost."""

    code = "cluster"


class BagError(DriveIdError):
    """Base of errors in a recording's container, found before any sample is read."""

    code = "bag"


class NotABagError(BagError):
    """The path is not a recording in a format that drive_id reads."""

    code = "not_a_bag"


class TruncatedBagError(BagError):
    """The recording is cut off (killed recorder, power loss, full disk) or damaged."""

    code = "truncated_bag"


class MissingTopicError(BagError):
    """The bag has no topic for a required signal."""

    code = "missing_topic"


class MessageTypeError(BagError):
    """The type or the fields of a topic do not carry the signal."""

    code = "message_type"


class EmptyTopicError(BagError):
    """A required topic exists but holds no message or no sample."""

    code = "empty_topic"


class MessageCountError(BagError):
    """Fewer messages could be read than the bag itself declares."""

    code = "message_count"


class DataError(DriveIdError):
    """Base of errors in the samples themselves."""

    code = "data"


class NonFiniteError(DataError):
    """Samples are NaN or infinite."""

    code = "non_finite"


class StampOrderError(DataError):
    """Too many stamps repeat or run backwards."""

    code = "stamp_order"


class SamplePeriodError(DataError):
    """Sample periods disagree: between signals, or between declaration and stamps."""

    code = "sample_period"


class NoOverlapError(DataError):
    """The three signals overlap too little in time."""

    code = "no_overlap"


class StandstillError(DataError):
    """The machine hardly turns, so its flux induces no measurable voltage."""

    code = "standstill"


class CoverageError(DataError):
    """The data cover too little of the current plane for a map, or not the currents asked for."""

    code = "coverage"


class UnexplainedError(DataError):
    """The fitted model leaves most of the voltage unexplained, so that its map means nothing."""

    code = "unexplained"
