"""Settings dataclasses as ROS parameters: types, bounds, nothing as NaN, empty lists, and refusals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from ros_bench import require_ros

from drive_id.common.settings import Checked, setting
from drive_id.errors import ConfigurationError


@dataclass(frozen=True)
class Some(Checked):
    count: int = setting(3, "How many", minimum=1, maximum=5)
    size: float = setting(1.0, "How large", unit="m", minimum=0.0)
    name: str = setting("a", "Which", choices=("a", "b"))
    limit: float | None = setting(None, "Up to where", minimum=0.0)
    times: tuple[float, ...] = setting((), "When", unit="s", minimum=0.0)
    gains: tuple[float, float] = setting((1.0, 2.0), "By what")
    orders: tuple[int, ...] = setting((6, 12), "Which ones", minimum=1)
    fixed: bool = setting(True, "For good")

    def __post_init__(self):
        super().__post_init__()
        if self.limit is not None and self.size > self.limit:
            raise ConfigurationError("size is beyond limit: make it smaller.")


@pytest.fixture
def make(tmp_path, monkeypatch):
    """Return a function that declares the settings on a node of a context with these arguments."""
    require_ros()
    from rclpy.context import Context
    from rclpy.node import Node

    from drive_id.nodes.support.parameters import declare_settings

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    opened = []

    def declare(*arguments):
        context = Context()
        context.init(args=["--ros-args", *arguments] if arguments else [])
        node = Node("some", context=context)
        opened.append((context, node))
        return node, declare_settings(node, Some, read_only=["fixed", "times"])

    yield declare
    for context, node in opened:
        node.destroy_node()
        context.try_shutdown()


def values(node, **changes):
    from rclpy.parameter import Parameter

    return node.set_parameters_atomically([Parameter(name, value=value) for name, value in changes.items()])


def test_the_defaults(make):
    from rclpy.parameter import Parameter

    node, settings = make()
    assert settings == Some()
    kinds = [node.get_parameter(name).type_ for name in ("count", "size", "name", "limit", "times", "gains", "fixed")]
    kind = Parameter.Type
    array = kind.DOUBLE_ARRAY
    assert kinds == [kind.INTEGER, kind.DOUBLE, kind.STRING, kind.DOUBLE, array, array, kind.BOOL]
    assert math.isnan(node.get_parameter("limit").value)
    assert node.describe_parameter("size").description == "How large [m]"
    assert node.describe_parameter("times").read_only
    assert node.describe_parameter("limit").additional_constraints == "at least 0, nan: the default"
    assert node.describe_parameter("times").additional_constraints == "each at least 0"
    assert node.describe_parameter("gains").additional_constraints == ""
    assert node.describe_parameter("name").additional_constraints == "one of a, b"


def test_a_parameter_file(make, tmp_path):
    path = tmp_path / "some.yaml"
    path.write_text("/**:\n  ros__parameters:\n    times: [1.0, 2.0]\n    limit: 4.0\n    gains: [0.0, 1.0]\n")
    assert make("--params-file", str(path))[1] == Some(times=(1.0, 2.0), limit=4.0, gains=(0.0, 1.0))
    path.write_text("/**:\n  ros__parameters:\n    times: []\n    limit: .nan\n    orders: []\n")
    assert make("--params-file", str(path))[1] == Some(orders=())


def test_parameters_that_do_not_exist_are_told(make, capfd):
    from drive_id.nodes.support.arguments import warn_of_unknown_parameters

    given = [f"{name}:=3" for name in ("count", "coumt", "zzzzzz", "qos_overrides./parameter_events.publisher.depth")]
    node, settings = make(*(word for text in given for word in ("-p", text)))
    warn_of_unknown_parameters(node)
    assert settings.count == 3
    logged = [line.partition("[some]: ")[2] for line in "".join(capfd.readouterr()).splitlines() if "[some]" in line]
    assert sorted(logged) == [
        "Unknown parameter coumt is ignored: did you mean count?",
        "Unknown parameter zzzzzz is ignored: 'ros2 param list' shows the parameters of each node.",
    ]


@pytest.mark.parametrize(
    "given", ["--params-file nowhere.yaml", "-r __ns:=bad-name", "-p count:=", "--frobnicate", "-r"]
)
def test_wrong_ros_arguments_are_told_in_one_sentence(given):
    require_ros()
    from rclpy.context import Context

    from drive_id.nodes.support.arguments import ros_arguments

    with (
        pytest.raises(
            ConfigurationError, match=r"^Invalid ROS arguments \(.+\): correct what follows --ros-args\.$"
        ) as told,
        ros_arguments(),
    ):
        Context().init(args=["--ros-args", *given.split()])
    assert "/project/" not in str(told.value)
    assert "\n" not in str(told.value)


def test_a_name_that_is_none_is_told_and_a_mistake_of_ours_is_not(make):
    from rclpy.node import Node

    from drive_id.nodes.support.arguments import ros_arguments

    node, _ = make()
    with pytest.raises(ConfigurationError, match="Invalid ROS arguments \\(Invalid namespace"), ros_arguments():
        Node("other", namespace="bad-name", context=node.context)
    with pytest.raises(RuntimeError, match="ours"), ros_arguments():
        raise RuntimeError("ours")


def test_a_wrong_start(make):
    from rclpy.exceptions import ParameterException

    for argument in ("count:=9", "count:=1.5", "size:=.nan", "size:=5", "times:=[a]"):
        with pytest.raises(ParameterException):
            make("-p", argument)
    for argument in ("name:=c", "limit:=0.5", "limit:=-1.0", "times:=[-1.0]", "gains:=[1.0]"):
        with pytest.raises(ConfigurationError):
            make("-p", argument)


def test_changes_are_checked_together_and_told(make):
    from drive_id.nodes.support.parameters import on_change

    node, _ = make()
    told = []

    def even(settings):
        if settings.count % 2 == 0:
            raise ConfigurationError("count is even.")

    on_change(node, Some, even, told.append)
    assert values(node, size=3.0, limit=4.0).successful
    assert values(node, limit=math.nan, size=9.0).successful
    assert told == [Some(size=3.0, limit=4.0), Some(size=9.0)]
    for changes, reason in (
        ({"size": 5.0, "limit": 4.0}, "size is beyond limit"),
        ({"count": 4}, "count is even"),
        ({"count": 6}, "out of range"),
        ({"limit": math.inf}, "finite"),
        ({"limit": None}, "cannot be undeclared"),
        ({"fixed": False}, "read-only"),
    ):
        result = values(node, **changes)
        assert not result.successful
        assert reason in result.reason
    assert len(told) == 2
