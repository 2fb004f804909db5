"""The rooms of the design and what each may import; imports in functions and for type checking count, too."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "drive_id"
COMMON = (
    "arguments", "health", "interrupts", "messages", "origins", "quantity", "settings", "temperature", "version",
)  # fmt: skip
NOUNS = {"drive_id.errors", "drive_id.types"} | {f"drive_id.common.{name}" for name in COMMON}
ROS = {
    "action_msgs", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "drive_id_msgs", "launch",
    "launch_ros", "lifecycle_msgs", "rcl_interfaces", "rclpy", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs",
}  # fmt: skip


@dataclass(frozen=True)
class Room:
    """What the modules of a room may import of ours and of others, itself and the standard library aside."""

    ours: frozenset[str]
    others: frozenset[str] = frozenset()

    @classmethod
    def of(cls, ours: set[str], others: set[str]) -> Room:
        return cls(frozenset(ours), frozenset(others))


def below(house: str, *rooms: str) -> set[str]:
    return {f"drive_id.{house}.{room}" for room in rooms}


CORE = {  # each with the rooms of core that it may import
    "frames": {"numerics"},
    "fit_settings": set(),
    "numerics": set(),
    "signals": {"numerics"},
    "maps": {"numerics"},
    "paper": {"frames", "maps", "numerics"},
    "full": {"frames", "fit_settings", "maps", "numerics"},
    "validation": {"frames", "maps", "numerics"},
    "steady": {"frames", "maps", "numerics"},
    "accumulation": {"frames", "fit_settings", "paper", "full", "maps", "numerics", "signals"},
    "methods": {"accumulation", "paper", "full", "validation", "maps", "numerics"},
    "checks": {"accumulation", "frames", "fit_settings", "maps", "numerics", "signals"},
    "result": {
        "checks", "accumulation", "methods", "validation", "paper", "full", "maps", "numerics", "frames",
        "fit_settings", "steady",
    },
    "experiment": {"maps", "signals", "numerics", "frames"},
    "planning": {"experiment", "full", "maps", "numerics", "frames"},
}  # fmt: skip
FILES = {
    "inputs": set(),
    "storage": {"inputs"},
    "messages": {"inputs", "storage"},
    "machines": {"inputs"},
    "logs": {"inputs", "storage"},
    "read": {"inputs", "storage", "messages", "machines", "logs"},
    "write": {"inputs", "storage", "messages", "machines"},
    "results": {"inputs", "storage", "messages", "machines", "read"},
}
EVERY_CORE = below("core", *CORE)
EVERY_FILE = below("files", *FILES)
LIBRARY = EVERY_CORE | EVERY_FILE | {"drive_id.bench"}
LIVE = {"drive_id.live", "drive_id.live.recording", "drive_id.live.identification"}
STORED = {"numpy", "scipy", "yaml", "rosbags", "mcap", "zstandard", "lz4", "typing_extensions"}
CONTAINERS = {"asammdf", "h5py", "nptdms", "pandas", "pyarrow"}

ROOMS = {
    "drive_id": Room.of(
        NOUNS
        | below("core", "fit_settings", "maps", "result", "steady")
        | {"drive_id.analysis", "drive_id.bench", "drive_id.core.planning", "drive_id.fitting", "drive_id.inspection"}
        | {"drive_id.result"}
        | {"drive_id.exchange.exports", "drive_id.exchange.imports"},
        set(),
    ),
    "drive_id.errors": Room.of(set(), set()),
    "drive_id.common": Room.of(set(), set()),
    "drive_id.common.health": Room.of(set(), set()),
    "drive_id.common.interrupts": Room.of(set(), set()),
    "drive_id.types": Room.of({"drive_id.errors", "drive_id.common.quantity"}, {"numpy"}),
    "drive_id.common.origins": Room.of({"drive_id.errors"}, set()),
    "drive_id.common.messages": Room.of({"drive_id.common.quantity"}, {"yaml"}),
    "drive_id.common.quantity": Room.of(set(), set()),
    "drive_id.common.temperature": Room.of(set(), set()),
    "drive_id.common.version": Room.of(set(), set()),
    "drive_id.common.settings": Room.of({"drive_id.errors"}, set()),
    "drive_id.common.arguments": Room.of({"drive_id.errors"}, set()),
    "drive_id.core": Room.of(set(), set()),
    **{
        f"drive_id.core.{name}": Room.of(
            NOUNS | below("core", *rooms),
            {"numpy", "scipy"} | ({"numba", "threadpoolctl"} if name == "numerics" else set()),
        )
        for name, rooms in CORE.items()
    },
    "drive_id.bench": Room.of(NOUNS | below("core", "experiment", "maps", "numerics", "signals"), {"numpy", "scipy"}),
    "drive_id.files": Room.of(set(), set()),
    **{
        f"drive_id.files.{name}": Room.of(
            NOUNS | EVERY_CORE | below("files", *rooms),
            STORED | {"logs": CONTAINERS, "inputs": {"fsspec"}}.get(name, set()),
        )
        for name, rooms in FILES.items()
    },
    "drive_id.result.pictures": Room.of(NOUNS | EVERY_CORE, {"numpy", "matplotlib"}),
    "drive_id.result": Room.of(
        NOUNS | EVERY_CORE | EVERY_FILE | {"drive_id.result.pictures"},
        {"numpy", "pandas", "xarray", "typing_extensions"},
    ),
    "drive_id.fitting": Room.of(
        NOUNS | LIBRARY | {"drive_id.result.pictures", "drive_id.reporting", "drive_id.result"},
        {"distributed", "matplotlib", "numpy"},
    ),
    "drive_id.inspection": Room.of(NOUNS | LIBRARY, {"numpy"}),
    "drive_id.analysis": Room.of(
        NOUNS | LIBRARY | {"drive_id.result.pictures", "drive_id.result"}, {"numpy", "scipy", "matplotlib", "pandas"}
    ),
    "drive_id.exchange": Room.of(set(), set()),
    "drive_id.exchange.exports": Room.of(
        NOUNS | LIBRARY | {"drive_id.analysis", "drive_id.result"}, {"numpy", "scipy"}
    ),
    "drive_id.exchange.imports": Room.of(
        NOUNS | LIBRARY | {"drive_id.analysis", "drive_id.fitting"}, {"numpy", "scipy"}
    ),
    "drive_id.reporting": Room.of(
        NOUNS | LIBRARY | {"drive_id.analysis", "drive_id.inspection", "drive_id.result.pictures", "drive_id.result"},
        {"numpy", "rich", "matplotlib", "jinja2", "plotly"},
    ),
    "drive_id.live": Room.of(NOUNS | LIBRARY | {"drive_id.fitting"}, {"numpy"}),
    "drive_id.live.recording": Room.of(NOUNS | LIBRARY | {"drive_id.live"}, {"numpy"}),
    "drive_id.live.identification": Room.of(
        NOUNS | LIBRARY | {"drive_id.fitting", "drive_id.live", "drive_id.reporting"}, {"numpy", "yaml"}
    ),
    "drive_id.nodes": Room.of(
        NOUNS | LIBRARY | {"drive_id.fitting", "drive_id.nodes.support", "drive_id.nodes.support.topics"} | LIVE,
        {"numpy", "yaml", *ROS},
    ),
    "drive_id.nodes.support.topics": Room.of(
        NOUNS | EVERY_CORE | EVERY_FILE | {"drive_id.nodes.support"} | LIVE, {"numpy", *ROS}
    ),
    "drive_id.nodes.support": Room.of(NOUNS | EVERY_CORE | EVERY_FILE | {"drive_id.fitting"} | LIVE, {"numpy", *ROS}),
    "drive_id.ros": Room.of(
        NOUNS
        | below("core", "experiment", "validation")
        | below("files", "machines")
        | {"drive_id.fitting", "drive_id.nodes", "drive_id.nodes.support"}
        | LIVE,
        {"numpy", "rich", "yaml", *ROS},
    ),
    "drive_id.reporting.web": Room.of(
        NOUNS | below("core", "maps", "result") | below("files", "results") | {"drive_id.result"},
        {"numpy", "jinja2", "starlette"},
    ),
    "drive_id.cli": Room.of(
        NOUNS
        | LIBRARY
        | {"drive_id.analysis", "drive_id.fitting", "drive_id.inspection", "drive_id.result.pictures"}
        | {"drive_id.exchange.exports", "drive_id.exchange.imports"}
        | {"drive_id.reporting", "drive_id.result", "drive_id.reporting.web"},
        {"typer", "rich", "uvicorn", "yaml"},
    ),
}


def room_of(module: str) -> str:
    """Return the room of a module of ours: the longest name in the table that it lies in."""
    parts = module.split(".")
    for length in range(len(parts), 1, -1):
        if ".".join(parts[:length]) in ROOMS:
            return ".".join(parts[:length])
    if module == "drive_id":
        return module
    raise AssertionError(f"{module} is in no room: put it into one, or add the room to this table and to the design.")


def imports(source: str, modules: Collection[str] = ()) -> Iterator[tuple[int, str]]:
    """Yield line and absolute name of everything that a source imports, wherever it does: rooms, modules or names."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: import absolutely."
            for name in (f"{node.module}.{alias.name}" for alias in node.names):
                whole = node.module == "drive_id" or name in ROOMS or name in modules
                yield node.lineno, name if whole else str(node.module)
        elif isinstance(node, ast.Call) and called(node) in ("__import__", "import_module"):
            argument = node.args[0] if node.args else None
            assert isinstance(argument, ast.Constant), f"line {node.lineno}: import by a name that can be read here."
            yield node.lineno, str(argument.value)


def called(node: ast.Call) -> str:
    return getattr(node.func, "id", getattr(node.func, "attr", ""))


def violations(module: str, source: str) -> list[str]:
    """Say which imports of a module its room does not allow."""
    own = room_of(module)
    found = []
    for line, name in imports(source):
        top = name.split(".")[0]
        if top == "drive_id":
            target = room_of(name)
            allowed = target == own or target in ROOMS[own].ours
        else:
            allowed = top in sys.stdlib_module_names or top in ROOMS[own].others
        if not allowed:
            found.append(f"{module}, line {line}: {own} must not import {name}")
    return found


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def circles(modules: dict[str, Path]) -> list[set[str]]:
    """Return the sets of files that import one another in a circle."""
    arrows = {
        name: {
            target
            for _, target in imports(path.read_text(encoding="utf-8"), modules)
            if target in modules and target != name
        }
        for name, path in modules.items()
    }
    reached: dict[str, set[str]] = {}
    for name in arrows:
        found, waiting = set(), [name]
        while waiting:
            for target in arrows[waiting.pop()] - found:
                found.add(target)
                waiting.append(target)
        reached[name] = found
    return [{name, *(x for x in found if name in reached[x])} for name, found in reached.items() if name in found]


def test_no_files_import_one_another_in_a_circle():
    assert circles(MODULES) == []


def house(room: str) -> str:
    """Return the folder of the package that a room is in."""
    return ".".join(room.split(".")[:2])


@pytest.mark.parametrize("of", [str, house], ids=["rooms", "houses"])
def test_no_rooms_import_one_another_in_a_circle(of):
    arrows: dict[str, set[str]] = {}
    for own in ROOMS:
        targets = {of(room_of(name)) for _, name in imports_of(own) if name.split(".")[0] == "drive_id"}
        arrows.setdefault(of(own), set()).update(targets - {of(own)})
    list(TopologicalSorter(arrows).static_order())


def imports_of(room: str) -> Iterator[tuple[int, str]]:
    for name, path in MODULES.items():
        if room_of(name) == room:
            yield from imports(path.read_text(encoding="utf-8"))


def test_each_class_has_a_name_of_its_own():
    names = Counter(
        node.name.lstrip("_")
        for path in MODULES.values()
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_circles_are_seen(tmp_path):
    sources = {"a": "import drive_id.b", "b": "def f():\n    from drive_id import c", "c": "from drive_id.a import x"}
    for name, source in (sources | {"d": "import drive_id.a"}).items():
        (tmp_path / f"{name}.py").write_text(source)
    found = circles({f"drive_id.{name}": tmp_path / f"{name}.py" for name in "abcd"})
    assert found == [{"drive_id.a", "drive_id.b", "drive_id.c"}] * 3


@pytest.mark.parametrize("module", MODULES)
def test_imports_keep_the_direction_of_the_arrows(module):
    assert not violations(module, MODULES[module].read_text(encoding="utf-8"))


def test_the_walk_finds_the_package():
    for name in (
        "drive_id",
        "drive_id.cli.app",
        "drive_id.fitting.fit",
        "drive_id.core.result.identify",
        "drive_id.files.storage.bag",
    ):
        assert name in MODULES
    assert len(MODULES) > 50


def test_the_initial_modules_import_nothing():
    """Importing one room must not load others behind its back."""
    for name, path in MODULES.items():
        if path.name == "__init__.py":
            found = [target for _, target in imports(path.read_text(encoding="utf-8"))]
            standard = sys.stdlib_module_names
            assert all(target.split(".")[0] in standard or target.startswith(f"{name}.") for target in found), name


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("drive_id.errors", "from drive_id.types import Samples"),
        ("drive_id.types", "import drive_id.common.settings"),
        ("drive_id.common.settings", "import numpy"),
        ("drive_id.core.result.identify", "from drive_id.files.storage.bag import open_bag"),
        ("drive_id.core.result.identify", "import matplotlib.pyplot as plt"),
        ("drive_id.core.result.identify", "def f():\n    from drive_id.bench import drive"),
        ("drive_id.core.result.identify", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import rclpy"),
        ("drive_id.core.result.identify", "try:\n    import yaml\nexcept ImportError:\n    yaml = None"),
        ("drive_id.core.result.identify", "import importlib\nimportlib.import_module('rclpy')"),
        ("drive_id.core.result.identify", "__import__('mcap')"),
        ("drive_id.core.result.identify", "from drive_id import fitting"),
        ("drive_id.bench.drive", "from drive_id.result.pictures.plots import to_png"),
        ("drive_id.bench.drive", "import numba"),
        ("drive_id.result.pictures.plots", "from drive_id.live.identification.identifier import Identifier"),
        ("drive_id.result.result", "def f():\n    from drive_id.reporting.page.report import write_report"),
        ("drive_id.reporting.page.content", "from drive_id.fitting.result import Identification"),
        ("drive_id.core.numerics.bspline", "from drive_id.core.maps.coverage import Visits"),
        ("drive_id.core.maps.coenergy", "from drive_id.core import full"),
        ("drive_id.core.paper.regression", "from drive_id.core.full.windows import windows"),
        ("drive_id.core.accumulation.evidence", "from drive_id.core.checks.prescan import Prescan"),
        ("drive_id.core.full.fit", "import numba"),
        ("drive_id.files.storage.bag", "from drive_id.files.read.reader import bag_pieces"),
        ("drive_id.files.read.reader", "import drive_id.files.results.folder"),
        ("drive_id.files.storage.bag", "import rclpy"),
        ("drive_id.files.storage.bag", "from drive_id_msgs.msg import Resolver"),
        ("drive_id.files.storage.bag", "from drive_id.bench.drive import simulate"),
        ("drive_id.fitting.fit", "from drive_id.cli.app import app"),
        ("drive_id.fitting.fit", "from drive_id.nodes.recorder import main"),
        ("drive_id.result.pictures.plots", "import typer"),
        ("drive_id.nodes.recorder", "import drive_id.cli.app"),
        ("drive_id.nodes.recorder", "from drive_id import cli"),
        ("drive_id.nodes.support.qos", "from drive_id.nodes.recorder import main"),
        ("drive_id.live.recording.recording_session", "from drive_id.live.identification.identifier import Identifier"),
        ("drive_id.cli.app", "from drive_id.nodes.recorder import main"),
        ("drive_id.cli.app", "import rclpy"),
    ],
)
def test_the_checker_sees_what_is_forbidden(module, source):
    assert len(violations(module, source)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("drive_id.core.result.identify", "import json\nimport numpy as np\nfrom drive_id.types import Samples"),
        ("drive_id.core.result.identify", "from drive_id.core import checks, frames"),
        ("drive_id.nodes.recorder", "import rclpy\nfrom drive_id.files.write.writer import write_recording"),
        ("drive_id.nodes.recorder", "from drive_id.fitting.fit import fit_bags"),
        ("drive_id.cli.app", "from drive_id.common.version import VERSION\nfrom drive_id.fitting.fit import fit_bags"),
        ("drive_id.fitting.result", "def f():\n    from drive_id.reporting.page.report import write_report"),
        ("drive_id.core.checks.prescan", "from drive_id.core.accumulation.evidence import Evidence"),
    ],
)
def test_the_checker_lets_pass_what_is_allowed(module, source):
    assert violations(module, source) == []


def test_the_checker_refuses_what_it_cannot_judge():
    with pytest.raises(AssertionError, match="in no room"):
        violations("drive_id.utils", "")
    with pytest.raises(AssertionError, match="in no room"):
        violations("drive_id.cli.app", "import drive_id.utils")
    with pytest.raises(AssertionError, match="import absolutely"):
        violations("drive_id.core.result.identify", "from . import frames")
    with pytest.raises(AssertionError, match="by a name that can be read"):
        violations("drive_id.core.result.identify", "import importlib\nimportlib.import_module(name)")
