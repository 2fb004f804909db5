"""Running a node as a process: the quickest executor that works, and a clean end on SIGINT and SIGTERM."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from drive_id.errors import DriveIdError

_WAKE_UP = 0.1  # s; how long a node without any callback to work off overlooks a signal


class Stop:
    """Remembers the first SIGINT or SIGTERM; only while nothing is spinning yet does it break off.

    Not rclpy's own handlers: they invalidate the context before a node can publish its last words.
    """

    def __init__(self) -> None:
        self.asked = False
        self.spinning = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, _number: int, _frame: FrameType | None) -> None:
        first, self.asked = not self.asked, True
        if first and not self.spinning:
            raise KeyboardInterrupt


def run(make: Callable[[], Node], args: Sequence[str] | None = None) -> None:
    """Make a node, spin it until the process is told to stop, close it, and end with exit code 0.

    Parameters
    ----------
    make : callable
        The node's class. A node that has ``close()`` is closed, while it can still publish, before it is destroyed.
    args : sequence of str, optional
        Command line; default that of the process.
    """
    stop = Stop()
    node: Node | None = None
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
        spin(node, stop)
    except (DriveIdError, ParameterException) as error:
        sys.stderr.write(f"{make.__name__}: {error}\n")
        raise SystemExit(1) from None
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is meant to be stopped
    finally:
        stop.asked = True  # from here on, signals do not break off the end
        close = getattr(node, "close", None)
        if close is not None:
            close()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        # Ctrl-C and a launcher often send one signal each; the second must not kill an interpreter that is going down.
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))


def spin(node: Node, stop: Stop) -> None:
    """Work off a node's callbacks until the process is told to stop or the context is shut down."""
    executor = _executor()
    executor.add_node(node)
    forever: Future[None] = Future()
    stop.spinning = True
    while rclpy.ok() and not stop.asked:
        executor.spin_until_future_complete(forever, _WAKE_UP)


def _executor() -> Executor:
    """Return an events executor where rclpy has one (a third of the cost per message), or the single-threaded one.

    Its ``spin()`` never returns in rclpy 7.1.6 and 9.1.2, hence the loop in :func:`spin`.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor  # noqa: PLC0415  # from rclpy 7.1 on
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()
