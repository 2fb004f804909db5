"""Replies are sent at a pace at which a client with the default queue of ten takes all of them."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from ros_bench import require_ros

TICK = 0.02
QUEUE = 10
"""Replies that a client keeps by default."""


@pytest.fixture
def paced(monkeypatch):
    """The services, the replies sent by a service of it with their times, and what lets time pass."""
    require_ros()
    from drive_id.nodes.support import deferred_service

    world = SimpleNamespace(now=0.0, sent=[], tick=None)
    monkeypatch.setattr(deferred_service, "time", SimpleNamespace(monotonic=lambda: world.now))
    node = SimpleNamespace(
        create_timer=lambda _, tick, **__: setattr(world, "tick", tick),
        create_service=lambda *_, **__: SimpleNamespace(
            send_response=lambda *reply: world.sent.append((world.now, reply))
        ),
    )
    world.services = deferred_service.PacedServices(node)

    def run(seconds):
        for _ in range(round(seconds / TICK)):
            world.now += TICK
            world.tick()

    world.run = run
    return world


def test_a_single_reply_is_sent_at_once(paced):
    service = paced.services.create(None, "~/start", None)
    for number in range(20):
        service.send_response("response", number)
        assert paced.sent[-1] == (paced.now, ("response", number))
        paced.run(TICK)


def test_a_thousand_replies_never_overflow_a_client_that_first_sends_all_its_requests(paced):
    """It listens after 0.25 s, and then empties its queue every 40 ms."""
    first, second = (paced.services.create(None, name, None) for name in ("~/start", "~/stop"))
    for number in range(1000):
        (first, second)[number % 2].send_response("response", number)
    paced.run(10.0)
    assert [number for _, (_, number) in paced.sent] == list(range(1000))
    times = [when for when, _ in paced.sent]
    assert times[-1] < 5.0
    assert sum(when < 0.25 for when in times) <= QUEUE
    assert max(sum(begin <= when < begin + 2 * TICK - 1e-9 for when in times) for begin in times) <= QUEUE
