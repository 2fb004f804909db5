"""One-sentence errors for invalid ROS arguments, and warnings for unknown parameters."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.exceptions import NameValidationException
from rclpy.node import Node

from drive_id.errors import ConfigurationError

_PLACES = re.compile(r",? at /\S+:\d+")
"""Positions in the source code of rcl, which its messages contain."""
_PREFIX = re.compile(r"^failed to (?:initialize rcl|parse ROS arguments): ", re.IGNORECASE)
_FOR_MIDDLEWARE = "qos_overrides."
"""Prefix of parameters that rclpy accepts without a declaration."""


@contextmanager
def ros_arguments() -> Iterator[None]:
    """Turn errors of rcl about ROS arguments into ConfigurationError, around ``init`` or the creation of a node.

    Raises ConfigurationError for a missing parameter file, an invalid name, or an unknown or incomplete argument.
    """
    try:
        yield
    except NameValidationException as error:
        reason = str(error).partition(":\n")[0]
    except RuntimeError as error:  # RCLError and UnknownROSArgsError are in a private module
        if not type(error).__module__.startswith("rclpy."):
            raise
        reason = _PREFIX.sub("", _PLACES.sub("", str(error)))
    else:
        return
    raise ConfigurationError(f"Invalid ROS arguments ({reason.strip(' .')}): correct what follows --ros-args.")


def warn_of_unknown_parameters(node: Node) -> None:
    """Log a warning for each parameter given at start that the node does not have: rclpy ignores it without a word.

    Parameters
    ----------
    node : Node
        With all its parameters declared.
    """
    given = [name for name in node._parameter_overrides if not name.startswith(_FOR_MIDDLEWARE)]  # noqa: SLF001
    unknown = [name for name in given if not node.has_parameter(name)]
    known = node.list_parameters([], 0).names if unknown else []
    for name in unknown:
        near = difflib.get_close_matches(name, known, 1)
        guess = f"did you mean {near[0]}?" if near else "'ros2 param list' shows the parameters of each node."
        node.get_logger().warning(f"Unknown parameter {name} is ignored: {guess}")
