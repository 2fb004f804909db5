"""What the nodes use of rclpy beyond its documented interface: each one named here, and noticed when rclpy changes."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import pytest
from ros_bench import require_ros

ROOMS = [Path(__file__).parent.parent.parent / "drive_id" / room for room in ("nodes", "ros")]
PRIVATE = {"_parameter_overrides", "_exit"}
"""Node._parameter_overrides: the only place that shows what was given at the start: an empty array, and parameters that
the node does not have. os._exit is Python's own."""


def test_no_other_private_member_is_used():
    """Of objects other than self; imports of private modules count, too."""
    found = set()
    for file in (file for room in ROOMS for file in room.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__"):
                of_self = isinstance(node.value, ast.Name) and node.value.id in {"self", "cls"}
                found |= set() if of_self else {node.attr}
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rclpy"):
                parts = [*str(node.module).split("."), *(name.name for name in node.names)]
                found |= {part for part in parts if part.startswith("_")}
    assert found == PRIVATE


def test_overrides_show_that_an_empty_array_was_given(ros):
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    node = Node("overrides", context=ros.context, cli_args=["--ros-args", "-p", "given:=[]"])
    try:
        assert "given" in node._parameter_overrides
        assert "other" not in node._parameter_overrides
        declared = node.declare_parameter("given", Parameter.Type.STRING_ARRAY)
        assert declared.type_ is Parameter.Type.NOT_SET  # why nothing public tells
    finally:
        node.destroy_node()


def test_a_service_asks_itself_for_callback_and_send_response(ros):
    """deferred_service replaces send_response of one service, guard_transitions the callback."""
    from std_srvs.srv import Trigger

    service = ros.node.create_service(Trigger, "asked", lambda _, response: response)
    said = []
    send = service.send_response
    service.callback = lambda *_: "later"
    service.send_response = lambda response, header: (said.append(response), send(Trigger.Response(), header))
    client = ros.node.create_client(Trigger, "asked")
    ros.wait(client.service_is_ready, "the service")
    future = client.call_async(Trigger.Request())
    ros.wait(future.done, "its reply")
    assert said == ["later"]
    ros.node.destroy_client(client)
    ros.node.destroy_service(service)


def test_messages_can_be_taken_from_a_subscription(ros):
    """MatchedSubscription.drain does."""
    from std_msgs.msg import String

    subscription = ros.node.create_subscription(String, "taken", lambda _: None, 10, raw=True)
    with subscription.handle:
        assert subscription.handle.take_message(String, True) is None
    ros.node.destroy_subscription(subscription)


def test_a_goal_that_executes_notifies_its_server():
    """_HoldingServer overrides notify_execute, so that a goal executes without a callback."""
    require_ros()
    from rclpy.action.server import ActionServer, ServerGoalHandle

    assert list(inspect.signature(ActionServer.notify_execute).parameters) == [
        "self",
        "goal_handle",
        "execute_callback",
    ]
    assert "notify_execute" in inspect.getsource(ServerGoalHandle.execute)


def test_errors_of_rcl_are_known_by_their_module(ros):
    """ros_arguments tells them from others so: their classes are in a private module."""
    from rclpy.context import Context
    from rclpy.node import Node

    with pytest.raises(RuntimeError) as unknown:
        Context().init(args=["--ros-args", "--frobnicate"])
    with pytest.raises(RuntimeError) as missing:
        Context().init(args=["--ros-args", "--params-file", "nowhere.yaml"])
    node = Node("names", context=ros.context)
    with pytest.raises(RuntimeError) as topic:  # ExtraTopics.resolved takes it for what is not the name of a topic
        node.resolve_topic_name("{nonsense}")
    node.destroy_node()
    assert {type(told.value).__module__.partition(".")[0] for told in (unknown, missing, topic)} == {"rclpy"}


def test_a_transition_that_leads_nowhere_raises_or_is_refused(ros):
    """Where rclpy raises, guard_transitions answers instead: with the events executor, the error ends the process."""
    from lifecycle_msgs.srv import ChangeState
    from rclpy.lifecycle import LifecycleNode

    node = LifecycleNode("managed", context=ros.context)
    (service,) = (service for service in node.services if service.srv_type is ChangeState)
    request = ChangeState.Request()
    request.transition.id = 99
    try:
        refused = not service.callback(request, ChangeState.Response()).success  # Kilted
    except RuntimeError as error:  # Jazzy
        refused = "Transition" in str(error)
    assert refused
    node.destroy_node()


def test_the_events_executor_is_where_it_was():
    """Without it the nodes run, three times slower: nothing else would tell."""
    require_ros()
    from rclpy.experimental.events_executor import EventsExecutor

    assert callable(EventsExecutor)
