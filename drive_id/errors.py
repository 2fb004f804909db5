"""One error tree: every message is one sentence saying what is wrong, where, and what to do.

``code`` is the stable, machine-readable name of the kind of error: services reply with it, ``--json`` prints it.
Nothing else leaves this package on bad input; anything that is not a :class:`DriveIdError` is a bug of ours.
"""

from __future__ import annotations


class DriveIdError(Exception):
    """Base of all errors that bad input can cause."""

    code = "error"


class ConfigurationError(DriveIdError):
    """A parameter, option, signals file or machine file does not make sense."""

    code = "configuration"


class OutputError(DriveIdError):
    """The result cannot be written where it was asked for (not ours to overwrite, not writable, disk full)."""

    code = "output"


class InformationError(DriveIdError):
    """An information file is none, is damaged, or was written by a newer version."""

    code = "information"


class FleetError(DriveIdError):
    """The cluster that was to do the work is not there, or was lost."""

    code = "fleet"


class BagError(DriveIdError):
    """Base of the errors of a recording's container: what was found before any sample was looked at."""

    code = "bag"


class NotABagError(BagError):
    """The path is not a recording that any of our back-ends can read."""

    code = "not_a_bag"


class TruncatedBagError(BagError):
    """The recording breaks off (killed recorder, power cut, full disk) or is damaged."""

    code = "truncated_bag"


class MissingTopicError(BagError):
    """A needed signal has no topic in the bag."""

    code = "missing_topic"


class MessageTypeError(BagError):
    """A topic is of a type, or lacks a field, from which the signal cannot be read."""

    code = "message_type"


class EmptyTopicError(BagError):
    """A needed topic exists but holds no message or no sample."""

    code = "empty_topic"


class MessageCountError(BagError):
    """Fewer messages could be read than the bag itself declares."""

    code = "message_count"


class DataError(DriveIdError):
    """Base of the errors of the samples themselves."""

    code = "data"


class NonFiniteError(DataError):
    """Samples are NaN or infinite."""

    code = "non_finite"


class StampOrderError(DataError):
    """Stamps repeat or run backwards too often to be cut out."""

    code = "stamp_order"


class SamplePeriodError(DataError):
    """The sample periods of the signals, or the declared and the stamped one, disagree."""

    code = "sample_period"


class NoOverlapError(DataError):
    """The three signals share too little time to be joined."""

    code = "no_overlap"


class StandstillError(DataError):
    """The machine hardly turns, so that its flux induces no voltage to see."""

    code = "standstill"


class CoverageError(DataError):
    """The trajectory covers too little of the current plane for a map."""

    code = "coverage"
