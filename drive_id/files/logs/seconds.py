"""Times in two columns: seconds, and nanoseconds beside them."""

from __future__ import annotations

from collections.abc import Collection

_ENDS = (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanoseconds"), ("s", "ns"))
"""How the names of both end, as ROS 2, ROS 1, Linux and others write them."""


def seconds_columns(stamp: str, names: Collection[str]) -> tuple[str, ...]:
    """Return the columns of seconds and nanoseconds that a time has among ``names``; nothing for one of one column.

    ``stamp`` is the column of the seconds, or what the names of both begin with: ``header.stamp``.
    """
    for end, other in _ENDS:
        stem, last = stamp[: -len(end)], stamp[-len(end) :]
        if last.lower() == end and not stem[-1:].isalnum() and {stamp, stem + other} <= set(names):
            return stamp, stem + other
        for sign in "._/":
            if {f"{stamp}{sign}{end}", f"{stamp}{sign}{other}"} <= set(names):
                return f"{stamp}{sign}{end}", f"{stamp}{sign}{other}"
    return ()
