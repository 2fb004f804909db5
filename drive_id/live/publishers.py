"""Who publishes a topic, and how reliably to subscribe to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drive_id.health import Finding, Level


@dataclass(frozen=True)
class Publisher:
    """Who offers a topic: full name of the node, type (``package/msg/Name``), and quality of service."""

    node: str
    type_name: str
    reliable: bool = True
    transient_local: bool = False
    depth: int = 0


def of_type(publishers: Sequence[Publisher], type_name: str) -> list[Publisher]:
    """Return those that publish the given type."""
    return [publisher for publisher in publishers if publisher.type_name == type_name]


def reliable_wanted(publishers: Sequence[Publisher], type_name: str, now: bool) -> bool:
    """Tell whether to subscribe reliably: from a publisher that is not, a reliable subscription receives nothing.

    Parameters
    ----------
    publishers : sequence of Publisher
        Of the topic.
    type_name : str
        The expected type.
    now : bool
        What is subscribed; kept while nobody publishes.
    """
    right = of_type(publishers, type_name)
    return all(publisher.reliable for publisher in right) if right else now


def publisher_findings(topic: str, type_name: str, publishers: Sequence[Publisher]) -> list[Finding]:
    """Tell what is wrong with the publishers of a topic that should be of one type."""
    findings: list[Finding] = []
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
        findings.append((Level.WARN, f"{names} publish {topic} both: their counts cannot be told apart."))
    return findings
