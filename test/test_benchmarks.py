"""The benchmarks name constants of the package as text, where no type checker sees them."""

from __future__ import annotations

import ast
import pkgutil
from pathlib import Path

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


def patched_names():
    """Return the targets of ``patch("...")`` in the benchmarks."""
    for file in BENCHMARKS.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(func=ast.Name(id="patch"), args=[ast.Constant(value=str(target)), *_]):
                    yield target


def test_what_a_benchmark_changes_exists():
    names = list(patched_names())
    assert names
    for name in names:
        pkgutil.resolve_name(name)
