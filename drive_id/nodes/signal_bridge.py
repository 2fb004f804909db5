"""The node ``signal_bridge``: publishes a bench's own topics as our messages, by a signals file."""

from __future__ import annotations

from pathlib import Path

from drive_id.common.health import Health, Level
from drive_id.errors import ConfigurationError
from drive_id.files.messages.signals_file import read_signals
from drive_id.live.translator import BridgeSettings, SignalBlock, Translator
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.diagnostics import publish_health
from drive_id.nodes.support.managed import ManagedNode
from drive_id.nodes.support.parameters import declare_settings
from drive_id.nodes.support.runtime import run
from drive_id.nodes.support.signal_messages import SignalPublishers
from drive_id.nodes.support.topics.foreign import ForeignTopics

_MATCH_PERIOD = 0.25  # s between checks of who publishes


class SignalBridge(ManagedNode):
    """Translates what arrives and publishes it in blocks, while it is active."""

    def __init__(self) -> None:
        super().__init__("signal_bridge")
        settings = declare_settings(self, BridgeSettings, read_only=BridgeSettings.__dataclass_fields__)
        if not settings.signals:
            raise ConfigurationError("The parameter signals is empty: name a signals file, see docs/logs.md.")
        self._translator = Translator(read_signals(Path(settings.signals).expanduser()))
        self._signals = SignalPublishers(self, settings.frame_id)
        self._depth = settings.queue_depth
        self._foreign: ForeignTopics | None = None
        self._published = 0
        self.create_timer(_MATCH_PERIOD, self._match, clock=STEADY)
        self.create_timer(settings.block_period, self._on_timer, clock=STEADY)
        publish_health(self, self._health)
        topics = ", ".join(self.resolve_topic_name(name) for name in self._translator.topics)
        self.bring_up(f"Ready: translating {topics}.")

    def connect(self) -> None:
        """Subscribe to the bench's topics."""
        self._foreign = ForeignTopics(self, self._translator, self._depth)

    def disconnect(self) -> None:
        """End the subscriptions."""
        if self._foreign is not None:
            self._foreign.close()
        self._foreign = None

    def _match(self) -> None:
        if self._foreign is not None:
            self._foreign.match()

    def _on_timer(self) -> None:
        for block in self._translator.advance():
            if self.active:
                self._publish(block)

    def _publish(self, block: SignalBlock) -> None:
        self._signals.publish("phase_currents", block, block.currents.T)
        self._signals.publish("phase_voltages", block, block.voltages.T)
        self._signals.publish("resolver", block, block.resolver.T)
        for name, values in block.scalars.items():
            self._signals.publish(name, block, [values])
        self._published += len(block.currents)

    def _health(self) -> Health:
        if not self.active or self._foreign is None:
            return self.inactive_health()
        report = self._translator.report()
        findings = self._foreign.findings()
        findings += [(Level.WARN, warning) for warning in report.warnings if self._published]
        doing = "The bench's topics are translated." if self._published else "Nothing has been translated yet."
        said = findings[0][1] if findings else doing
        values = {
            "samples": str(self._published),
            "gaps": str(report.gaps),
            "unreadable messages": str(self._translator.unreadable),
            "dropped messages": str(self._translator.dropped),
        }
        return Health(max((level for level, _ in findings), default=Level.OK), said, values)


def main() -> None:
    """Run the node ``signal_bridge``."""
    run(SignalBridge)


if __name__ == "__main__":
    main()
