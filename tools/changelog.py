"""Write the CHANGELOG.rst of both packages, which bloom reads, from CHANGELOG.md.

    python tools/changelog.py

Run it when a version is released. Unreleased entries are not copied: an entry in CHANGELOG.md needs no further step.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
TARGETS = {"drive_id": Path("CHANGELOG.rst"), "drive_id_msgs": Path("msg_defs/CHANGELOG.rst")}
"""By package; each file lies beside the package.xml."""
_HEADING = re.compile(r"^## \[?(?P<version>[^\]\s]+)\]?(?: - (?P<date>\d{4}-\d{2}-\d{2}))?$")
_CODE = re.compile(r"(`[^`]+`)")
_LINK = re.compile(r"\[([^]]+)\]\(([^)]+)\)")
_UNRELEASED = "* Nothing is released yet; CHANGELOG.md of the repository lists the changes."
_MESSAGES = "* Released with drive_id, whose changelog names the changes of messages, services and actions."


@dataclass(frozen=True)
class Version:
    """One section of CHANGELOG.md.

    Parameters
    ----------
    name : str
        Version, or ``Unreleased``.
    date : str or None
        ISO date; None: not released.
    entries : tuple of str
        One line each, in Markdown, led by the name of its group (Added, Changed, ...).
    """

    name: str
    date: str | None
    entries: tuple[str, ...]


def versions(markdown: str) -> list[Version]:
    """Return the sections of a changelog in the format of Keep a Changelog, the newest first.

    Raises
    ------
    ValueError
        For a heading without a version and date, or text that belongs to no entry.
    """
    found: list[tuple[str, str | None, list[str]]] = []
    group = ""
    for number, line in enumerate(markdown.splitlines(), 1):
        if line.startswith("## "):
            heading = _HEADING.match(line)
            if heading is None or (heading["date"] is None) != (heading["version"] == "Unreleased"):
                raise ValueError(f"CHANGELOG.md:{number}: write '## [1.2.3] - 2026-01-31' or '## [Unreleased]'.")
            found.append((heading["version"], heading["date"], []))
            group = ""
        elif not found or not line.strip():
            continue
        elif line.startswith("### "):
            group = line.removeprefix("### ").strip() + ": "
        elif line.startswith("- "):
            found[-1][2].append(group + line.removeprefix("- ").strip())
        elif line.startswith("  ") and found[-1][2]:
            found[-1][2][-1] += " " + line.strip()
        else:
            raise ValueError(f"CHANGELOG.md:{number}: the line belongs to no entry; indent it, or begin it with '- '.")
    return [Version(name, date, tuple(entries)) for name, date, entries in found]


def restructured(text: str) -> str:
    """Return Markdown of one line as reStructuredText: literals, links as text with their target, the rest escaped."""

    def plain(part: str) -> str:
        return re.sub(r"([\\*|]|_(?=\W|$))", r"\\\1", _LINK.sub(r"\1 (\2)", part))

    return "".join(f"`{part}`" if _CODE.fullmatch(part) else plain(part) for part in _CODE.split(text))


def changelog(package: str, found: list[Version]) -> str:
    """Return the CHANGELOG.rst of a package, in the layout of REP 132."""
    title = f"Changelog for package {package}"
    lines = ["^" * len(title), title, "^" * len(title), "", ".. Written by tools/changelog.py from CHANGELOG.md.", ""]
    released = [version for version in found if version.date is not None]
    if not released:
        lines += ["Forthcoming", "-----------", _UNRELEASED, ""]
    for version in released:
        heading = f"{version.name} ({version.date})"
        entries = [f"* {restructured(entry)}" for entry in version.entries] if package == "drive_id" else [_MESSAGES]
        lines += [heading, "-" * len(heading), *entries, ""]
    return "\n".join(lines)


def main() -> None:
    """Write both files."""
    try:
        found = versions((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    except ValueError as error:
        raise SystemExit(str(error)) from None
    for package, target in TARGETS.items():
        (ROOT / target).write_text(changelog(package, found), encoding="utf-8")
        print(target)


if __name__ == "__main__":
    main()
