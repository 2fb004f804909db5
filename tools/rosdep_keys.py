"""List the keys of both package.xml files that the ROS build farm cannot install.

    git clone --depth 1 https://github.com/ros/rosdistro
    python tools/rosdep_keys.py rosdistro

Prints a Markdown table of the keys without a system package on at least one of the distribution's platforms. "pip"
means that rosdep installs the key on a developer's computer; the build farm does not.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parent.parent
MANIFESTS = (ROOT / "package.xml", ROOT / "msg_defs" / "package.xml")
DISTROS = ("jazzy", "kilted")
INSTALLERS = {"apt", "dnf", "packages", "pip", "yum"}
"""Keys of a rule that is the same for all versions of an operating system."""


def keys(manifests: tuple[Path, ...] = MANIFESTS) -> list[str]:
    """Return the dependencies of both packages but those on each other, sorted."""
    roots = [ET.parse(file).getroot() for file in manifests]
    own = {root.findtext("name") for root in roots}
    named = {element.text or "" for root in roots for element in root if element.tag.endswith("depend")}
    return sorted(named - own)


def loaded(file: Path) -> dict[str, Any]:
    """Return a file of rosdistro."""
    content = yaml.load(file.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    return dict(content)


def released(distribution: Mapping[str, Any]) -> set[str]:
    """Return the ROS packages that a distribution has released."""
    found: set[str] = set()
    for name, repository in distribution["repositories"].items():
        release = repository.get("release", {})
        if "version" in release:
            found.update(release.get("packages", [name]))
    return found


def installed_by(rule: object, version: str) -> str:
    """Return what installs a key on one version of an operating system: ``package``, ``pip`` or ``nothing``."""
    if isinstance(rule, dict) and not INSTALLERS & rule.keys():
        rule = rule.get(version, rule.get("*"))
    if isinstance(rule, dict):
        return "pip" if "pip" in rule else "package"
    return "package" if rule else "nothing"


def findings(folder: Path, distro: str, names: list[str]) -> dict[str, dict[str, str]]:
    """Return for each key what installs it, by platform.

    Parameters
    ----------
    folder : Path
        A checkout of rosdistro.
    distro : str
        Its ROS distribution.
    names : list of str
        Keys.
    """
    distribution = loaded(folder / distro / "distribution.yaml")
    rules = {**loaded(folder / "rosdep" / "base.yaml"), **loaded(folder / "rosdep" / "python.yaml")}
    packages = released(distribution)
    return {
        name: {
            f"{system} {version}": "package"
            if name in packages
            else installed_by(rules.get(name, {}).get(system), version)
            for system, versions in distribution["release_platforms"].items()
            for version in versions
        }
        for name in names
    }


def main() -> None:
    """Print the table of each distribution."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("rosdistro", type=Path, help="a checkout of github.com/ros/rosdistro")
    folder = parser.parse_args().rosdistro
    names = keys()
    for distro in DISTROS:
        if not (folder / distro / "distribution.yaml").is_file():
            raise SystemExit(f"{folder} has no {distro}/distribution.yaml: give a checkout of rosdistro.")
        found = findings(folder, distro, names)
        platforms = sorted(next(iter(found.values())))
        missing = {name: by for name, by in found.items() if set(by.values()) != {"package"}}
        print(f"{distro}: {len(names) - len(missing)} of {len(names)} keys are packages on all platforms.\n")
        print("| key | " + " | ".join(platforms) + " |\n|" + "---|" * (len(platforms) + 1))
        for name, by in missing.items():
            print(f"| `{name}` | " + " | ".join(by[platform] for platform in platforms) + " |")
        print()


if __name__ == "__main__":
    main()
