"""YAML of bounded size: read by libyaml where it is there, and refused where aliases would multiply it.

Nine lines of aliases of aliases stand for a billion entries ("billion laughs"), which take no memory until something
prints them or merges them; a number of a million digits takes minutes to convert.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import yaml

MOST_ENTRIES = 300_000
"""Scalars, lists and mappings in one file, aliases counted with what they stand for."""
_DEEPEST = 100  # levels: Python recurses for each
_TOO_DEEP = "it is nested too deeply"
_LIBYAML_TOO_DEEP = "exceeded maximum nesting depth"
"""What libyaml says from 0.2.6 on."""
_LONGEST_SEXAGESIMAL = 64  # characters of a number such as 1:30, whose digits yaml multiplies out
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_SHORT = 1 << 14  # characters that cannot hold more entries than are allowed
_FASTEST = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load_yaml(text: str, most: int = MOST_ENTRIES, look: Callable[[yaml.Node], None] = lambda _: None) -> Any:
    """Return a YAML document as plain values; ``look`` sees its nodes before, with the lines where they are.

    Raises yaml.YAMLError when it is not YAML, ValueError when it has more entries (aliases stand for what they repeat),
    is nested too deeply or holds an endless number.
    """
    try:  # before its document is built: libyaml crashes on deep nesting, and PyYAML recurses
        _check_events(text, most, _FASTEST)
    except yaml.YAMLError as error:
        if len(text) < _SHORT:
            _check_events(text, most, yaml.SafeLoader)  # tells the line better than libyaml
        if getattr(error, "problem", None) == _LIBYAML_TOO_DEEP:  # by its scanner, before it tells of any depth
            raise ValueError(_TOO_DEEP) from error
        raise
    loader = _FASTEST(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        if _entries(node, {}) > most:
            raise ValueError("its aliases stand for too many entries")
        look(node)
        return loader.construct_document(node)
    finally:
        loader.dispose()


def line_of(error: Exception) -> int:
    """Return the line, from 1, in which a text turned out to be no YAML; 0 where it is not known."""
    mark = getattr(error, "problem_mark", None)
    return mark.line + 1 if mark else 0


def _check_events(text: str, most: int, loader: type) -> None:
    depth = count = 0
    for event in yaml.parse(text, Loader=loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
            continue
        count += 1
        if depth > _DEEPEST:
            raise ValueError(_TOO_DEEP)
        if count > most:
            raise ValueError("it has too many entries")


def _entries(node: yaml.Node, known: dict[int, int]) -> int:
    """Return the number of entries of a node, aliases followed; ``known`` are those of nodes seen before."""
    if id(node) in known:
        if known[id(node)] == 0:
            raise ValueError("it contains itself")
        return known[id(node)]
    if isinstance(node, yaml.ScalarNode):
        if node.tag in _NUMBERS and ":" in node.value and len(node.value) > _LONGEST_SEXAGESIMAL:
            raise ValueError("it holds a number of many digits")  # 1:30:15 is one, converted in quadratic time
        return 1
    known[id(node)] = 0
    inner = node.value if isinstance(node, yaml.SequenceNode) else [part for pair in node.value for part in pair]
    known[id(node)] = 1 + sum(_entries(part, known) for part in inner)
    return known[id(node)]
