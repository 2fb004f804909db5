"""What the node ``identification`` listens to: the signals of a drive, or a bench's own topics that stand for them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from drive_id_msgs.msg import ScalarSamples

from drive_id.common.health import Observation
from drive_id.files.messages.signals_file import read_signals
from drive_id.live.identification.identifier import Identifier
from drive_id.live.identification.inbox import Inbox
from drive_id.live.publishers import Publisher
from drive_id.live.translator import Translator
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.managed import ManagedNode
from drive_id.nodes.support.signal_messages import KINDS
from drive_id.nodes.support.topics.foreign import ForeignTopics
from drive_id.nodes.support.topics.matched import MatchedSubscription
from drive_id.types import SCALARS

_MATCH_PERIOD = 0.25  # s between checks of who publishes
_TRANSLATION_PERIOD = 0.02  # s between blocks of foreign messages
_FOREIGN_DEPTH = 5000  # foreign messages that may wait while the node is busy


class LiveTopics:
    """Subscribes between :meth:`open` and :meth:`close`; what arrives counts while the node is active.

    The identifier receives the samples; our messages wait in the inbox while the node is behind. ``signals`` is the
    signals file of a bench with topics of its own; empty: it publishes our messages.
    """

    def __init__(self, node: ManagedNode, identifier: Identifier, inbox: Inbox, signals: str) -> None:
        self._node, self._identifier, self._inbox = node, identifier, inbox
        self._translator = Translator(read_signals(Path(signals).expanduser()), sort=True) if signals else None
        self._foreign: ForeignTopics | None = None
        self._topics: list[MatchedSubscription] = []
        self._scalars: list[MatchedSubscription] = []
        node.create_timer(_MATCH_PERIOD, self._match, clock=STEADY)
        if self._translator is not None:
            node.create_timer(_TRANSLATION_PERIOD, partial(self._translate, self._translator), clock=STEADY)

    def open(self) -> None:
        """Subscribe."""
        if self._translator is None:
            self._topics = [
                self._subscription(kind, name, partial(self._identifier.receive, section))
                for section, (name, kind) in enumerate(KINDS.items())
            ]
        else:
            self._foreign = ForeignTopics(self._node, self._translator, _FOREIGN_DEPTH)
        self._scalars = [
            self._subscription(ScalarSamples, name, partial(self._identifier.receive_scalar, name)) for name in SCALARS
        ]

    def close(self) -> None:
        """End the subscriptions."""
        for topic in (*self._topics, *self._scalars):
            topic.close()
        if self._foreign is not None:
            self._foreign.close()
        self._topics, self._scalars, self._foreign = [], [], None

    def publishers(self) -> list[list[Publisher]]:
        """Return who publishes each of the three signals as our messages."""
        return [topic.publishers for topic in self._topics] or [[] for _ in KINDS]

    def findings(self) -> list[Observation]:
        """Return what is wrong with a bench's own topics."""
        return self._foreign.findings() if self._foreign is not None else []

    def _subscription(self, kind: type, name: str, handle: Callable[[bytes], None]) -> MatchedSubscription:
        def take(data: bytes) -> None:
            if self._node.active:
                self._inbox.take(handle, data)

        return MatchedSubscription(self._node, kind, name, take)

    def _match(self) -> None:
        for topic in (*self._topics, *self._scalars):
            topic.match()
        if self._topics:
            self._identifier.publishers(self.publishers())
        if self._foreign is not None:
            self._foreign.match()

    def _translate(self, translator: Translator) -> None:
        for block in translator.advance():
            if self._node.active:
                self._identifier.receive_block(block)
