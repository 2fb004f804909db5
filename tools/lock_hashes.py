"""Write the SHA-256 of every file of each pinned distribution into the lock files of the ROS 2 wheels.

    python tools/lock_hashes.py tools/lock-jazzy.txt tools/lock-kilted.txt

Run it after a pin has changed. pip then refuses a wheel whose content is another than the one tested.
"""

from __future__ import annotations

import json
import re
import sys
import urllib.request
from pathlib import Path

INDEX = "https://pypi.org/simple"
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s\\]+)")


def hashes(name: str, version: str) -> list[str]:
    """Return the SHA-256 of all files of a version on the Python package index, sorted."""
    request = urllib.request.Request(f"{INDEX}/{name}/", headers={"Accept": "application/vnd.pypi.simple.v1+json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        files = json.load(answer)["files"]
    marks = (f"-{version}-", f"-{version}.tar.gz", f"-{version}.zip")
    found = sorted({file["hashes"]["sha256"] for file in files if any(mark in file["filename"] for mark in marks)})
    if not found:
        raise SystemExit(f"{name} {version} is not on the index: correct the pin.")
    return found


def hashed(text: str) -> str:
    """Return a lock file with the hashes of its pins; comments stay, earlier hashes go."""
    lines = []
    for line in text.splitlines():
        if line.strip().startswith("--hash"):
            continue
        pin = _PIN.match(line)
        if pin is None:
            lines.append(line)
            continue
        own = [f"    --hash=sha256:{digest}" for digest in hashes(*pin.groups())]
        lines.append(" \\\n".join([pin.group(), *own]))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Rewrite the files named on the command line."""
    for name in sys.argv[1:]:
        path = Path(name)
        path.write_text(hashed(path.read_text(encoding="utf-8")), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
