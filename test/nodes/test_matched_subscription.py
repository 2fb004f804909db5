"""Subscriptions as reliable as their publishers: what has arrived is not lost, whoever works it off."""

from __future__ import annotations

import pytest
from ros_bench import DEADLINE, require_ros, ros_bench


@pytest.fixture
def ros():
    with ros_bench() as bench:
        yield bench


@pytest.fixture(autouse=True, scope="module")
def _ros_or_skip():
    require_ros()


def publish(publisher, numbers):
    from drive_id_msgs.msg import Resolver
    from rclpy.duration import Duration

    for number in numbers:
        publisher.publish(Resolver(first_sample=number))
    assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))


def test_drain_takes_everything_that_has_arrived(ros):
    """Without it, the test's single-threaded executor takes one message at a time."""
    from drive_id_msgs.msg import Resolver

    from drive_id.nodes.matched_subscription import MatchedSubscription
    from drive_id.nodes.qos import STREAM

    got = []
    subscription = MatchedSubscription(ros.node, Resolver, "resolver", lambda message: got.append(message.first_sample))
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

    from drive_id.nodes.matched_subscription import MatchedSubscription
    from drive_id.nodes.qos import STREAM, STREAM_BEST_EFFORT

    got = []
    subscription = MatchedSubscription(
        ros.node, Resolver, "resolver", lambda data: got.append(bytes(data)), depth=1000, raw=True
    )
    publisher = ros.node.create_publisher(Resolver, "resolver", STREAM)
    ros.wait(publisher.get_subscription_count, "the subscription")
    publish(publisher, range(300))
    ros.node.create_publisher(Resolver, "resolver", STREAM_BEST_EFFORT)
    while subscription.reliable:
        subscription.match()
    assert len(got) == 300
