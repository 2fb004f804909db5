"""Characterize a drive from a program of your own, with rclpy and the messages only: python experiment_client.py 0017.

It runs one goal of the node experiment and prints what it waits for. Ctrl-C cancels the goal: the current ramps to
zero, and the bag is kept. The exit code is 0 if the whole experiment succeeded.
"""

import signal
import sys
import time
from typing import Any

import rclpy
from drive_id_msgs.action import Experiment
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Empty

SILENCE = 10.0  # s without feedback, which comes twice a second, after which the node is gone, and heartbeats end


def show(message: Any, heard: list[float]) -> None:
    """Print how far the goal is, and note when it was heard of."""
    now = message.feedback
    heard[0] = time.monotonic()
    r = f", R {1e3 * now.resistance:.3f} ± {1e3 * now.sigma_resistance:.3f} mOhm" if now.resistance > 0 else ""
    print(f"{100 * now.share:3.0f} %  {now.phase}{r}: {now.waits_for}", flush=True)


def main(serial: str = "", duration: str = "0.0") -> int:
    """Run one experiment with the drive of this serial number, and return the exit code."""
    stop, heard = [], [0.0]
    signal.signal(signal.SIGINT, lambda *_: stop.append(True))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("test_bench")
    client = ActionClient(node, Experiment, "experiment/experiment")
    heartbeat = node.create_publisher(Empty, "experiment/heartbeat", 1)
    node.create_timer(0.2, lambda: heartbeat.publish(Empty()))  # if this program dies, the current goes to zero
    client.wait_for_server(timeout_sec=60.0)
    goal = Experiment.Goal(serial=serial, duration=float(duration), lease_time=2.0)
    sent = client.send_goal_async(goal, feedback_callback=lambda message: show(message, heard))
    rclpy.spin_until_future_complete(node, sent, timeout_sec=60.0)
    heard[0] = time.monotonic()
    if sent.result() is None:
        print("The node experiment does not answer.")
        return 2
    over = sent.result().get_result_async()
    while not over.done() and time.monotonic() < heard[0] + SILENCE:
        if stop:
            stop.clear()
            sent.result().cancel_goal_async()
        rclpy.spin_once(node, timeout_sec=0.1)
    if not over.done():
        print("The node experiment is gone: if current still flows, press the emergency stop.")
        return 2
    result = over.result().result
    print(f"{result.code}: {result.message}\nbags: {', '.join(result.bags)}\nresult: {result.output}")
    return 0 if result.success else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
