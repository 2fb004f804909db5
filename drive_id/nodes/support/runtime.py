"""Running a node as a process: the fastest executor that works, and a clean end on SIGINT, SIGTERM and SIGHUP."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from drive_id.errors import DriveIdError
from drive_id.nodes.support.arguments import ros_arguments, warn_of_unknown_parameters
from drive_id.nodes.support.middleware import fast_dds
from drive_id.nodes.support.shared_memory import SharedMemoryPorts

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""SIGHUP tells that the terminal was closed or the connection was lost; with nohup, it is ignored from the start."""
_POINT = ". A DOUBLE is written with a decimal point, as in 300.0."
_WAKE_UP = 0.1  # s after which an idle node notices a signal at the latest
_LISTEN = 0.5  # s between looks at whether the process still hears others


class Stop:
    """Records the first of the signals, and raises nothing: an exception anywhere in a start may end in a traceback.

    rclpy's own handlers invalidate the context before a node can publish its last messages.
    """

    def __init__(self) -> None:
        self.asked = False
        self.reason = ""
        """Why the process ends although nobody told it to; empty otherwise."""
        self._read_end, self._write_end = os.pipe()
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, lambda *_: self._ask())

    def _ask(self) -> None:
        first, self.asked = not self.asked, True
        if first:
            os.write(self._write_end, b"!")  # takes no lock: the interrupted code may hold it

    def listen(self) -> None:
        """End the process when it does not hear others any more: nobody could end or stop it by a message."""

        def watch() -> None:
            ports = SharedMemoryPorts()
            while not self.asked:
                time.sleep(_LISTEN)
                if port := ports.deaf():
                    self.reason = (
                        f"Fast DDS has replaced the port {port} while the process was held up, so that it hears nobody "
                        "any more: start it again."
                    )
                    self._ask()

        threading.Thread(target=watch, name="listen", daemon=True).start()

    def complete(self, future: Future[None]) -> None:
        """Complete a future when the process is told to stop."""

        def wait() -> None:
            os.read(self._read_end, 1)
            future.set_result(None)

        threading.Thread(target=wait, name="stop", daemon=True).start()


def run(make: Callable[[], Node], *, shared_memory: bool = True) -> None:
    """Create a node, spin it until the process is told to stop, close it, and end the process.

    The exit code is 0, or 1 with one sentence when the node cannot be created or does not hear others any more.

    Parameters
    ----------
    make : callable
        The node's class. Its ``close()``, if any, is called while the node can still publish.
    shared_memory : bool
        As in :func:`~.middleware.fast_dds`.
    """
    stop = Stop()
    node: Node | None = None
    code = 0
    try:
        with fast_dds(shared_memory=shared_memory):
            with ros_arguments():
                rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            node = make()
            warn_of_unknown_parameters(node)
        stop.listen()
        spin(node, stop)
        if stop.reason:
            raise DriveIdError(stop.reason)
    except (DriveIdError, ParameterException) as error:
        remedy = _POINT if isinstance(error, InvalidParameterTypeException) and "DOUBLE" in str(error) else ""
        with suppress(OSError):  # the terminal may be gone
            sys.stderr.write(f"{make.__name__}: {error}{remedy}\n")
        code = 1
    except ExternalShutdownException:
        pass  # somebody else shut the context down
    finally:
        # Ctrl-C and a launcher often send one signal each: the second must not interrupt the shutdown.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        close = getattr(node, "close", None)
        if close is not None:
            close()
        if node is not None:
            node.destroy_node()
        else:
            gc.collect()  # destroys a half-created node, so that it leaves the graph
        rclpy.try_shutdown()
    _leave(code)


def _leave(code: int) -> NoReturn:
    """End the process without finalizing the interpreter.

    Finalizing takes seconds on a busy machine, waits for a fit inside compiled code, and Python 3.11 ends with SIGINT
    instead of the exit code if a KeyboardInterrupt has ever passed through an ``exec`` (numba's, for example).
    """
    with suppress(OSError):  # the terminal may be gone
        sys.stdout.flush()
        sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)  # logs of rcl on stdout
    os._exit(code)


def spin(node: Node, stop: Stop) -> None:
    """Run a node's callbacks until the process is told to stop or the context is shut down."""
    gc.collect()
    gc.freeze()  # what is loaded by now stays: looking it through again takes 10 to 100 ms, in which no callback runs
    executor = _executor()
    executor.add_node(node)
    over: Future[None] = Future()
    stop.complete(over)  # a busy events executor never checks its timeout
    while rclpy.ok() and not stop.asked:
        executor.spin_until_future_complete(over, _WAKE_UP)


def _executor() -> Executor:
    """Return an events executor where rclpy has one (a third of the cost per message), else the single-threaded one.

    Its ``spin()`` never returns in rclpy 7.1.6 and 9.1.2, hence the loop in :func:`spin`.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor  # noqa: PLC0415  # from rclpy 7.1 on
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()
