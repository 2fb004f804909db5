"""Which runs are permitted, before anything moves: by the settings of their publisher and the limits of its drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.errors import ExperimentError

LIMIT = "limit"
"""Code of what a limit forbids, in the services and the action that start."""


def permitted(
    settings: ExperimentSettings, run: Mapping[str, Any], current_limit: float, speed_limit: float
) -> ExperimentSettings:
    """Return the settings of a run, which replaces some of them.

    The limits are those of the drive, see :func:`beyond_drive`.

    Raises
    ------
    ConfigurationError
        When such a run is not possible.
    ExperimentError
        With code ``limit``, when a limit forbids it.
    """
    wanted = run.get("i_max", settings.i_max)
    if settings.i_max < wanted < math.inf:
        most = f"the parameter of trajectory_publisher, {settings.i_max:g} A"
        raise ExperimentError(f"i_max is {wanted:g} A, more than {most}.", LIMIT)
    own = replace(settings, **run) if run else settings
    if (reason := beyond_drive(own, current_limit, speed_limit)) is not None:
        raise ExperimentError(reason, LIMIT)
    return own


def beyond_drive(settings: ExperimentSettings, current_limit: float, speed_limit: float) -> str | None:
    """Return why the limits of the drive, A and rad/s, forbid a start; infinite ones are those it does not state."""
    if settings.watch and math.isinf(min(speed_limit, math.inf if settings.speed_max is None else settings.speed_max)):
        return (
            "speed_max is not set, and the drive reports no speed_limit: set speed_max, the highest electrical speed "
            "at which the machine may be driven, in rad/s."
        )
    if settings.i_max > current_limit * (1 + 1e-6):
        return f"i_max is {settings.i_max:g} A, above the current_limit of the drive, {current_limit:g} A."
    return None
