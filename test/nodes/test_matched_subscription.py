"""Subscriptions as reliable as their publishers: what has arrived is not lost, whoever works it off."""

from __future__ import annotations

import pytest
from ros_bench import DEADLINE, ros_bench

from drive_id.files.messages.block_codec import read_head


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


def number_of(data):
    return read_head(data).first_sample


def publish(publisher, numbers):
    from drive_id_msgs.msg import Resolver
    from rclpy.duration import Duration

    for number in numbers:
        publisher.publish(Resolver(first_sample=number))
    assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))


def test_drain_takes_everything_that_has_arrived(ros):
    """Without it, the test's single-threaded executor takes one message at a time."""
    from drive_id_msgs.msg import Resolver

    from drive_id.nodes.support.qos import STREAM
    from drive_id.nodes.support.topics.matched import MatchedSubscription

    got = []
    subscription = MatchedSubscription(ros.node, Resolver, "resolver", lambda data: got.append(number_of(data)))
    publisher = ros.node.create_publisher(Resolver, "resolver", STREAM)
    ros.wait(publisher.get_subscription_count, "the subscription")
    subscription.drain()
    assert got == []
    publish(publisher, range(500))
    subscription.drain()
    assert got == list(range(500))
    publish(publisher, [500])
    ros.wait(lambda: len(got) > 500, "a message by the executor")
    assert got == list(range(501))


@pytest.mark.filterwarnings("ignore:Deprecated in favor of:DeprecationWarning")  # rclpy of Kilted in itself
def test_nothing_is_lost_when_it_is_made_anew(ros):
    from drive_id_msgs.msg import Resolver

    from drive_id.nodes.support.qos import STREAM, STREAM_BEST_EFFORT
    from drive_id.nodes.support.topics.matched import MatchedSubscription

    got = []
    subscription = MatchedSubscription(ros.node, Resolver, "resolver", got.append)
    publisher = ros.node.create_publisher(Resolver, "resolver", STREAM)
    ros.wait(publisher.get_subscription_count, "the subscription")
    publish(publisher, range(300))
    ros.node.create_publisher(Resolver, "resolver", STREAM_BEST_EFFORT)
    while subscription.reliable:
        subscription.match()
    assert len(got) == 300


@pytest.mark.filterwarnings("ignore:Deprecated in favor of:DeprecationWarning")  # rclpy of Kilted in itself
def test_an_events_executor_survives_that_it_is_made_anew(ros):
    """Messages and an incompatible publisher wait for the executor, and then the subscription goes."""
    from drive_id_msgs.msg import Resolver

    from drive_id.nodes.support.qos import STREAM, STREAM_BEST_EFFORT
    from drive_id.nodes.support.topics.matched import MatchedSubscription

    executors = pytest.importorskip("rclpy.experimental.events_executor")
    from rclpy.task import Future

    got, rounds, over = [], [], Future()
    subscription = MatchedSubscription(ros.node, Resolver, "resolver", lambda data: got.append(number_of(data)))
    publisher = ros.node.create_publisher(Resolver, "resolver", STREAM)
    ros.wait(publisher.get_subscription_count, "the subscription")

    def tick():
        if len(rounds) == 20:
            over.set_result(None)
            return
        first = 60 * len(rounds)
        rounds.append(first)
        rival = ros.node.create_publisher(Resolver, "resolver", STREAM_BEST_EFFORT)
        publish(publisher, range(first, first + 50))
        while subscription.reliable:
            subscription.match()
        ros.node.destroy_publisher(rival)
        while not subscription.reliable:
            subscription.match()
        while not publisher.get_subscription_count():
            pass
        publish(publisher, range(first + 50, first + 60))

    ros.executor.remove_node(ros.node)
    executor = executors.EventsExecutor(context=ros.context)
    executor.add_node(ros.node)
    timer = ros.node.create_timer(1e-3, tick)
    executor.spin_until_future_complete(over, DEADLINE)
    subscription.drain()
    executor.remove_node(ros.node)
    ros.node.destroy_timer(timer)
    assert len(rounds) == 20
    assert got == list(range(1200))
