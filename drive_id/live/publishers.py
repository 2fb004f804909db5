"""Publishers of a topic, and the reliability to subscribe with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drive_id.common.health import Level, Observation


@dataclass(frozen=True)
class Publisher:
    """A publisher: full name of its node, message type (``package/msg/Name``), quality of service, and its identity."""

    node: str
    type_name: str
    reliable: bool = True
    transient_local: bool = False
    depth: int = 0
    identity: str = ""  # as long as it lives, and of no other one


def of_type(publishers: Sequence[Publisher], type_name: str) -> list[Publisher]:
    """Return the publishers of the given type."""
    return [publisher for publisher in publishers if publisher.type_name == type_name]


def reliable_wanted(publishers: Sequence[Publisher], type_name: str, now: bool) -> bool:
    """Tell whether to subscribe reliably: a reliable subscription receives nothing from a best-effort publisher.

    Parameters
    ----------
    publishers : sequence of Publisher
        Of the topic.
    type_name : str
        The expected type.
    now : bool
        The present reliability; kept while nobody publishes.
    """
    right = of_type(publishers, type_name)
    return all(publisher.reliable for publisher in right) if right else now


def publisher_findings(topic: str, type_name: str, publishers: Sequence[Publisher]) -> list[Observation]:
    """Return what is wrong with the publishers of a topic: wrong type, best effort, more than one."""
    findings: list[Observation] = []
    for publisher in publishers:
        if publisher.type_name != type_name:
            sentence = f"{publisher.node} publishes {publisher.type_name} on {topic} instead of {type_name}."
            findings.append((Level.ERROR, sentence))
        elif not publisher.reliable:
            sentence = f"{publisher.node} offers {topic} as best effort only: samples may be lost."
            findings.append((Level.WARN, sentence))
    right = of_type(publishers, type_name)
    if len(right) > 1:
        names = " and ".join(publisher.node for publisher in right)
        findings.append((Level.WARN, f"{names} both publish {topic}: stop one, their sample counts mix."))
    return findings


def uncounted(topic: str) -> str:
    """Return what to say of a topic whose publisher does not count its samples."""
    return f"first_sample of {topic} is always 0, so that losses do not show: have its publisher count the samples."
