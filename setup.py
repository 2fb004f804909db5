"""Metadata of drive_id, for pip and for colcon.

They live here, not in pyproject.toml: colcon does not understand a ``[project]`` table.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "drive_id"

# For logs that are not bags: CSV and Parquet, MDF4, TDMS, HDF5 and MATLAB 7.3.
CONTAINERS = ["asammdf>=7.4", "h5py>=3.8", "npTDMS>=1.7", "pandas>=2", "pyarrow>=14"]
# For "drive-id serve".
WEB = ["starlette>=0.36", "uvicorn>=0.27"]
# For "drive-id fit --dask": the oldest version for Python 3.10 to 3.13 that was tried.
DASK = ["distributed>=2024.12"]
# For recordings on object storage; s3fs, gcsfs and others come on top.
REMOTE = ["fsspec>=2024.2"]
# Programs that the tests read exported maps with.
READERS = ["fmpy>=0.3.20", 'motulator>=0.18; python_version >= "3.12"']
TABLES = ["pandas>=2", "xarray>=2023.1"]

# Executables: a command line tool, and ROS 2 nodes for ``ros2 run drive_id ...``.
EXECUTABLES = [
    "drive-id = drive_id.cli.app:main",
    "trajectory_publisher = drive_id.nodes.trajectory_publisher:main",
    "recorder = drive_id.nodes.recorder:main",
    "identification = drive_id.nodes.identification:main",
    "commissioning = drive_id.ros.commissioning:main",
    "experiment = drive_id.ros.experiment:main",
    "characterize = drive_id.ros.characterize:main",
    "signal_bridge = drive_id.nodes.signal_bridge:main",
    "bench_simulator = drive_id.nodes.bench_simulator:main",
    "live_feed = drive_id.nodes.live_feed:main",
]


def version() -> str:
    """Read the version from the source text: importing it would need the dependencies."""
    text = Path(NAME, "common", "version.py").read_text(encoding="utf-8")
    found = re.search(r'^VERSION = "([^"]+)"$', text, re.MULTILINE)
    if found is None:
        raise SystemExit(f'{NAME}/common/version.py has no line VERSION = "...": add it.')
    return found.group(1)


def long_description() -> str:
    """Return the README, or nothing in a copy that has none."""
    readme = Path("README.md")
    return readme.read_text(encoding="utf-8") if readme.exists() else ""


def shared_files() -> list[tuple[str, list[str]]]:
    """List what a ROS 2 package installs below ``share/``; folders without files are left out."""
    files = [
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(map(str, Path("config").glob("*.*")))),
        (f"share/{NAME}/config/sros2", sorted(map(str, Path("config/sros2").glob("*.xml")))),
        (f"share/{NAME}/examples/bridge", sorted(map(str, Path("examples/bridge").glob("*.yaml")))),
        (f"share/{NAME}/launch", sorted(map(str, Path("launch").glob("*.py")))),
    ]
    return [(folder, names) for folder, names in files if names]


setup(
    name=NAME,
    version=version(),
    description="Identify flux maps, resistance and inverter voltage error of electric drives from recordings",
    long_description=long_description(),
    long_description_content_type="text/markdown",
    maintainer="drive_id maintainers",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    classifiers=[
        "License :: OSI Approved :: Apache Software License",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: [
            "py.typed",
            "common/messages.yaml",
            "exchange/exports/writers/flux_map.h",
            "exchange/exports/writers/fmu/*",
            "files/messages/signals.schema.json",
            "reporting/page/templates/*",
            "reporting/web/templates/*",
        ]
    },
    data_files=shared_files(),
    # rclpy and the message packages come from ROS 2, not from here: everything but the nodes works without them.
    install_requires=[
        "jinja2>=3.1",
        "lz4>=4",
        "matplotlib>=3.6",
        "mcap>=1.6",
        "numba>=0.58",
        "numpy>=1.26",
        "plotly>=6",
        "PyYAML>=6",
        "rich>=13",
        "rosbags>=0.11",
        "scipy>=1.11",
        "threadpoolctl>=3",
        "typer>=0.9,<0.29",  # from 0.29 on it loads pydantic with every command, which takes longer than to read a bag
        "zstandard>=0.22",
    ],
    # colcon runs 0 tests, and reports success, unless the extra "test" names pytest.
    extras_require={
        "containers": CONTAINERS,
        "dask": DASK,
        "remote": REMOTE,
        "tables": TABLES,
        "web": WEB,
        "test": [
            "httpx>=0.25",
            "hypothesis>=6.98",
            "jsonschema>=4.18",
            "pytest>=7.4",
            "pytest-timeout>=2.1",
            "pytest-xdist>=3.5",
            "selenium>=4.16",
            *CONTAINERS,
            *DASK,
            *READERS,
            *REMOTE,
            *TABLES,
            *WEB,
        ],
    },
    entry_points={"console_scripts": EXECUTABLES},
    zip_safe=False,
)
