"""The shell commands that pages and ``make help`` show."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    page
    for pattern in ("*.md", "docs/*.md", "docs/engineering/*.md", "examples/**/*.md")
    for page in ROOT.glob(pattern)
    if page.name != "CHANGELOG.md"
)
PROGRAMS = {
    *("apt", "bash", "cd", "colcon", "curl", "docker", "drive-id", "export", "git", "ln", "make", "pip", "python"),
    *("python3", "ros2", "rosdep", "source", "ssh", "sudo"),
}
"""An indented or fenced line that begins with one of these, or with a path of ``.venv``, is a command."""
_SHELLS = ("", "bash", "console", "sh", "shell")


@dataclass(frozen=True)
class Command:
    """One command of a page; ``text`` has no comment, and continued lines are joined."""

    page: str
    text: str
    comment: str = ""

    @property
    def words(self) -> list[str]:
        """The words of the first command of a line, on whatever computer it runs."""
        words = shlex.split(self.text)
        for mark in ("&&", "||", ";"):
            words = words[: words.index(mark)] if mark in words else words
        return words[2:] if words[0] == "ssh" else words


def commands(*programs: str, pages: list[Path] = PAGES) -> list[Command]:
    """Return the commands of these programs, or of all, in the order of the pages."""
    found = []
    for page in pages:
        fence = None
        text = re.sub(r" \\\n\s*", " ", page.read_text(encoding="utf-8"))
        for line in text.splitlines():
            if mark := re.match(r"\s*```(.*)", line):
                fence = mark[1].strip() if fence is None else None
                continue
            shown = line.startswith("    ") if fence is None else fence in _SHELLS
            word = line.split(maxsplit=1)[0] if line.strip() else ""
            if shown and (word in PROGRAMS or word.startswith(".venv/bin/")):
                code, _, comment = line.strip().partition(" #")
                found.append(Command(str(page.relative_to(ROOT)), code.strip(), comment))
    found = [each for each in found if not each.text.startswith("drive-id:")]  # an answer
    return [each for each in found if not programs or each.words[0] in programs]


def make_commands() -> set[str]:
    """Return what ``make`` is called with on the pages, in their comments, in ``make help``, and each target alone."""
    lines = [(each.text.removeprefix("make "), each.comment) for each in commands("make")]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    lines += re.findall(r"^([a-z-]+):.*?## (.*)$", makefile, re.MULTILINE)
    for page in PAGES:  # in a sentence
        lines += [(text, "") for text in re.findall(r"`make ([^`.]+)`", page.read_text(encoding="utf-8"))]
    found = set()
    for text, comment in lines:
        targets = [word for word in shlex.split(text) if "=" not in word]
        found |= {text, *targets}
        for variables in re.findall(r'((?:JOBS=\d )?ARGS=(?:"[^"]*"|[^\s,;:]+))', comment):
            found.add(f"{targets[0]} {variables}")
    return {" ".join(map(shlex.quote, shlex.split(text))).replace("'ARGS=", "ARGS='") for text in found}
