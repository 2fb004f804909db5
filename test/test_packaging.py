"""What is written about the package in several places agrees, and a wheel of it is complete."""

import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from email.parser import HeaderParser
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

import drive_id

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "drive_id").rglob("*.py"))

# Where an import comes from: the name on the Python package index and the rosdep key; None: rosdep has no key for it.
LIBRARIES: dict[str, tuple[str, str | None]] = {
    "jinja2": ("jinja2", "python3-jinja2"),
    "lz4": ("lz4", "mcap-ros2-support"),
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "mcap": ("mcap", "mcap-ros2-support"),
    "numba": ("numba", "python3-numba"),
    "numpy": ("numpy", "python3-numpy"),
    "plotly": ("plotly", None),
    "rich": ("rich", "python3-rich"),
    "rosbags": ("rosbags", "python3-rosbags-pip"),
    "scipy": ("scipy", "python3-scipy"),
    "threadpoolctl": ("threadpoolctl", None),
    "typer": ("typer", "python3-typer"),
    "yaml": ("PyYAML", "python3-yaml"),
    "zstandard": ("zstandard", "mcap-ros2-support"),
}
OPTIONAL = {
    "asammdf": "containers",
    "distributed": "dask",
    "fsspec": "remote",
    "h5py": "containers",
    "nptdms": "containers",
    "pandas": "containers",
    "pyarrow": "containers",
    "starlette": "web",
    "uvicorn": "web",
    "xarray": "tables",
}
"""An import on demand: the extra that brings it."""

ROS_PACKAGE = re.compile(
    r"rclpy|\w+_(msgs|srvs|interfaces)"
)  # not on the index: the dependency in package.xml suffices


@pytest.fixture
def metadata(monkeypatch):
    """Return what setup.py tells setuptools, of which it needs no more than two names."""
    told = {}
    setuptools = SimpleNamespace(find_packages=lambda **_: [], setup=told.update)
    monkeypatch.setitem(sys.modules, "setuptools", setuptools)
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py")
    return told


@pytest.fixture(scope="module")
def manifest():
    return ET.parse(ROOT / "package.xml").getroot()


def dependencies(manifest, *kinds):
    return {element.text for kind in kinds for element in manifest.iter(kind)}


class Imports(ast.NodeVisitor):
    """Collects the top-level names that a module imports when it runs."""

    def __init__(self):
        self.names = set()

    def visit_Import(self, node):
        self.names |= {alias.name.partition(".")[0] for alias in node.names}

    def visit_ImportFrom(self, node):
        self.names.add(node.module.partition(".")[0])

    def visit_If(self, node):
        if ast.unparse(node.test) != "TYPE_CHECKING":
            self.generic_visit(node)


def third_party_imports():
    """Return the top-level names that drive_id imports from elsewhere, each with a file that does."""
    found = {}
    for file in SOURCES:
        imports = Imports()
        imports.visit(ast.parse(file.read_text(encoding="utf-8")))
        found |= dict.fromkeys(imports.names, str(file.relative_to(ROOT)))
    return {name: file for name, file in found.items() if name not in sys.stdlib_module_names and name != "drive_id"}


def test_versions_agree(metadata, manifest):
    messages = ET.parse(ROOT / "msg_defs" / "package.xml").getroot()
    assert metadata["version"] == drive_id.__version__
    assert manifest.findtext("version") == drive_id.__version__
    assert messages.findtext("version") == drive_id.__version__


def test_both_descriptions_of_the_package_agree(metadata, manifest):
    assert manifest.findtext("name") == metadata["name"]
    assert manifest.findtext("license") == metadata["license"]
    assert manifest.findtext("maintainer") == metadata["maintainer"]
    assert manifest.find("maintainer").get("email") == metadata["maintainer_email"]
    assert manifest.findtext("description") == metadata["description"] + "."


def test_both_packages_name_the_same_people_and_licence(manifest):
    messages = ET.parse(ROOT / "msg_defs" / "package.xml").getroot()
    assert messages.findtext("license") == manifest.findtext("license")
    people = [
        [
            (person.tag, person.text, person.get("email"))
            for kind in ("maintainer", "author")
            for person in root.iter(kind)
        ]
        for root in (manifest, messages)
    ]
    assert people[0] == people[1]


@pytest.mark.parametrize("folder", [".", "msg_defs"])
def test_the_tools_of_ros_accept_the_package(folder):
    package = pytest.importorskip("catkin_pkg.package", reason="catkin_pkg is not installed: it comes with ROS 2")
    warnings: list[str] = []
    package.parse_package(str(ROOT / folder), warnings=warnings).validate(warnings)
    assert warnings == []


def test_every_import_is_a_declared_dependency(metadata, manifest):
    required = {re.match(r"[\w.-]+", text)[0] for text in metadata["install_requires"]}
    declared = dependencies(manifest, "depend", "exec_depend")
    for name, file in third_party_imports().items():
        if ROS_PACKAGE.fullmatch(name):
            assert name in declared, f"{file} imports {name}: name it in package.xml"
            continue
        if name in OPTIONAL:
            extra = metadata["extras_require"][OPTIONAL[name]]
            assert set(extra) <= set(metadata["extras_require"]["test"]), f"the tests need what {file} imports"
            continue
        assert name in LIBRARIES, f"{file} imports {name}: name it in setup.py, package.xml and here"
        distribution, key = LIBRARIES[name]
        assert distribution in required, f"{file} imports {name}: name {distribution} in setup.py"
        assert key is None or key in declared, f"{file} imports {name}: name {key} in package.xml"


def test_no_library_is_known_in_one_place_only(metadata, manifest):
    required = {re.match(r"[\w.-]+", text)[0] for text in metadata["install_requires"]}
    assert required == {distribution for distribution, _ in LIBRARIES.values()}
    launching = {"launch", "launch_ros"}  # what launch/ imports is nothing for pip
    assert dependencies(manifest, "exec_depend") == {key for _, key in LIBRARIES.values() if key} | launching


def test_the_release_page_says_what_rosdep_cannot_install(metadata):
    page = (ROOT / "docs" / "engineering" / "release.md").read_text(encoding="utf-8")
    unknown = {distribution for distribution, key in LIBRARIES.values() if key is None}
    wanted = [f'"{text}"' for text in metadata["install_requires"] if re.match(r"[\w.-]+", text)[0] in unknown]
    assert f"    pip install {' '.join(wanted)}\n" in page


def test_every_executable_exists(metadata):
    executables = metadata["entry_points"]["console_scripts"]
    assert any(text.startswith("drive-id = ") for text in executables)
    for text in executables:
        module, _, function = text.partition("=")[2].strip().partition(":")
        tree = ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))
        assert any(isinstance(node, ast.FunctionDef) and node.name == function for node in tree.body), text


def test_colcon_can_read_the_package(metadata, manifest):
    """Each of these has made colcon fail, or run no tests and call that success."""
    assert manifest.findtext("export/build_type") == "ament_python"
    assert "[project]" not in (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines()
    assert any(text.startswith("pytest") for text in metadata["extras_require"]["test"])
    assert "drive_id_msgs" in dependencies(manifest, "depend"), "colcon would not build the messages first"
    scripts = (ROOT / "setup.cfg").read_text(encoding="utf-8")
    assert scripts.count("=$base/lib/drive_id\n") == len(["script_dir", "install_scripts"])


def test_colcon_lists_both_packages_of_a_workspace(tmp_path):
    """It looks no further once it has found a package: the docs tell to link the messages, or to call it here."""
    colcon = shutil.which("colcon", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    assert colcon, "colcon is missing: make setup installs it, or source a ROS 2"
    source = tmp_path / "src"
    source.mkdir()
    (source / "drive_id").symlink_to(ROOT)
    docs = (ROOT / "docs" / "installation.md").read_text(encoding="utf-8")
    (link,) = re.findall(r"^ +(ln -s .*)$", docs, re.MULTILINE)
    subprocess.run(link.split(), cwd=tmp_path, check=True)

    def found(folder):
        command = [colcon, "--log-base", str(tmp_path / "log"), "list"]
        listed = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout
        return {tuple(line.split("\t")[:2]) for line in listed.splitlines()}

    assert found(tmp_path) == {("drive_id", "src/drive_id"), ("drive_id_msgs", "src/drive_id_msgs")}
    assert found(ROOT) == {("drive_id", "."), ("drive_id_msgs", "msg_defs")}


def test_whatever_a_node_reads_is_installed(metadata):
    installed = {name: folder for folder, names in metadata["data_files"] for name in names}
    assert installed.pop("resource/drive_id") == "share/ament_index/resource_index/packages"
    assert installed.pop("package.xml") == "share/drive_id"
    shared = [path for pattern in ("config/**/*", "launch/*", "examples/bridge/*") for path in ROOT.glob(pattern)]
    files = {str(file.relative_to(ROOT)) for file in shared if file.is_file()}
    assert installed == {name: f"share/drive_id/{Path(name).parent}" for name in files}


def test_a_wheel_is_complete_and_its_command_goes_to_bin(tmp_path):
    """In spite of setup.cfg, which sends colcon's executables to lib/drive_id."""
    for name in ("pip", "setuptools", "wheel"):
        if not find_spec(name):
            pytest.skip(f"this environment cannot build wheels without {name}: pip install 'setuptools<80' wheel")
    copy = tmp_path / "source"
    copy.mkdir()
    for name in ("drive_id", "resource", "config", "launch"):
        if (ROOT / name).exists():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "."],
        check=True,
        cwd=copy,
        env=os.environ | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"},
    )
    (wheel,) = copy.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        information = f"drive_id-{drive_id.__version__}.dist-info"
        commands = archive.read(f"{information}/entry_points.txt").decode()
        fields = HeaderParser().parsestr(archive.read(f"{information}/METADATA").decode())
    assert {str(file.relative_to(ROOT)) for file in SOURCES} <= names
    files = {"drive_id/py.typed", "drive_id/files/messages/signals.schema.json"}
    assert files | {"drive_id/exchange/exports/writers/flux_map.h"} <= names
    templates = (ROOT / "drive_id/reporting/page/templates").iterdir()
    assert {str(file.relative_to(ROOT)) for file in templates} <= names
    assert any(name.startswith(information) and name.endswith("/LICENSE") for name in names)
    assert f"drive_id-{drive_id.__version__}.data/data/share/drive_id/package.xml" in names
    assert not [name for name in names if "lib/drive_id/" in name or ".data/scripts/" in name]
    assert "drive-id = drive_id.cli.app:main" in commands
    assert fields["Version"] == drive_id.__version__
    assert fields["Requires-Python"] == ">=3.10"
