"""ROS arguments of a command line, and parameters that no node has: wrong ones are told in a sentence."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.exceptions import NameValidationException
from rclpy.node import Node

from drive_id.errors import ConfigurationError

_PLACES = re.compile(r",? at /\S+:\d+")
"""Where rcl has found a mistake, in its own source."""
_PREFIX = re.compile(r"^failed to (?:initialize rcl|parse ROS arguments): ", re.IGNORECASE)
_FOR_MIDDLEWARE = "qos_overrides."
"""Parameters that a node may be given without declaring them."""


@contextmanager
def ros_arguments() -> Iterator[None]:
    """Tell what rcl has against ROS arguments; the body holds ``init``, or creates a node whose name they may change.

    Raises
    ------
    ConfigurationError
        When the body refuses them: a missing parameter file, a name that is none, an unknown or incomplete argument.
    """
    try:
        yield
    except NameValidationException as error:
        reason = str(error).partition(":\n")[0]
    except RuntimeError as error:  # RCLError and UnknownROSArgsError, which are in a private module
        if not type(error).__module__.startswith("rclpy."):
            raise
        reason = _PREFIX.sub("", _PLACES.sub("", str(error)))
    else:
        return
    raise ConfigurationError(f"ROS refuses the arguments ({reason.strip(' .')}): correct what follows --ros-args.")


def warn_of_unknown_parameters(node: Node) -> None:
    """Warn of parameters given at the start that the node does not have, which rclpy ignores.

    Parameters
    ----------
    node : Node
        All its parameters are declared.
    """
    given = [name for name in node._parameter_overrides if not name.startswith(_FOR_MIDDLEWARE)]  # noqa: SLF001
    unknown = [name for name in given if not node.has_parameter(name)]
    known = node.list_parameters([], 0).names if unknown else []
    for name in unknown:
        near = difflib.get_close_matches(name, known, 1)
        guess = f"did you mean {near[0]}?" if near else "ros2 param list shows all parameters."
        node.get_logger().warning(f"There is no parameter {name}, so its value is ignored: {guess}")
