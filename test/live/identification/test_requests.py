"""The queue of requests: one under way, one that waits, the rest refused; ends that come, and ends that do not."""

from __future__ import annotations

import threading
import time

import pytest

from drive_id.core.numerics import threads
from drive_id.errors import ConfigurationError
from drive_id.live.identification import requests as module
from drive_id.live.identification.identifier import BUSY, CANCELLED, Reply
from drive_id.live.identification.requests import MOST_ABANDONED, Request, Requests, Stage

DONE = Reply("ok", "Done.")


class Desk:
    """Requests whose calls are made in the test's thread, and jobs that the test ends."""

    def __init__(self, time_limit=0.0, **options):
        self.calls, self.replies, self.stages = [], [], []
        self.requests = Requests(time_limit, self.calls.append, **options)
        self.release = threading.Event()

    def submit(self, name, job, *, may_wait=True):
        request = Request(
            lambda: job,
            lambda reply: self.replies.append((name, reply)),
            lambda stage: self.stages.append((name, stage)),
        )
        self.requests.submit(request, may_wait=may_wait)
        return request

    def until(self, condition, timeout=20.0):
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end
            while self.calls:
                self.calls.pop(0)()
            self.requests.look()
            time.sleep(0.005)

    def patient(self, tell):
        """A job that can be cancelled."""
        while not self.release.wait(0.005):
            tell("Solving", None)
        return DONE

    def deaf(self, _):
        """A job that cannot, such as one that waits for a disk."""
        self.release.wait(60.0)
        return DONE


@pytest.fixture
def desk(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.2)
    desk = Desk()
    yield desk
    desk.release.set()


def test_one_runs_one_waits_and_the_rest_is_refused(desk):
    desk.submit("first", desk.patient)
    desk.submit("service", desk.patient, may_wait=False)
    desk.submit("second", lambda _: DONE)
    desk.submit("third", desk.patient)
    assert desk.replies == [("service", BUSY), ("third", BUSY)]
    desk.release.set()
    desk.until(lambda: len(desk.replies) == 4)
    assert desk.replies[2:] == [("first", DONE), ("second", DONE)]
    assert not desk.requests.busy
    assert desk.requests.findings() == []


@pytest.mark.parametrize("kind", ["patient", "deaf"])
def test_a_cancelled_request_frees_the_place_at_once(desk, kind):
    first = desk.submit("first", getattr(desk, kind))
    desk.submit("second", lambda _: DONE)
    start = time.monotonic()
    desk.requests.cancel(first, CANCELLED)
    desk.until(lambda: len(desk.replies) == 2)
    assert time.monotonic() - start < 1.0
    assert desk.replies == [("first", CANCELLED), ("second", DONE)]
    assert len(desk.requests.findings()) == (kind == "deaf")
    desk.release.set()
    desk.until(lambda: not desk.requests.findings())
    assert len(desk.replies) == 2  # what comes too late is nobody's


def test_a_waiting_request_is_cancelled_without_having_begun(desk):
    desk.submit("first", desk.patient)
    second = desk.submit("second", desk.patient)
    desk.requests.cancel(second, CANCELLED)
    desk.requests.cancel(second, CANCELLED)
    assert desk.replies == [("second", CANCELLED)]
    desk.release.set()
    desk.until(lambda: len(desk.replies) == 2)


def test_a_request_that_takes_too_long(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.1)
    desk = Desk(time_limit=0.2)
    desk.submit("wedged", desk.deaf)
    desk.submit("next", lambda _: DONE)
    desk.until(lambda: len(desk.replies) == 2)
    assert [(name, reply.code) for name, reply in desk.replies] == [("wedged", "time_limit"), ("next", "ok")]
    assert "time_limit, 0.2 s" in desk.replies[0][1].message
    desk.release.set()


def test_wedged_requests_do_not_pile_up_without_end(desk):
    for number in range(MOST_ABANDONED):
        desk.requests.cancel(desk.submit(str(number), desk.deaf), CANCELLED)
        desk.until(lambda number=number: len(desk.replies) == number + 1)
    desk.submit("one more", desk.deaf)
    assert desk.replies[-1] == ("one more", BUSY)
    ((_, said),) = desk.requests.findings()
    assert f"{MOST_ABANDONED} cancelled requests" in said
    desk.release.set()
    desk.until(lambda: not desk.requests.findings())
    desk.submit("again", lambda _: DONE)
    desk.until(lambda: not desk.requests.busy)
    assert desk.replies[-1] == ("again", DONE)


def test_a_job_that_cannot_be_made_is_answered_and_the_next_one_runs(desk):
    def refuse():
        raise ConfigurationError("No.")

    desk.submit("first", desk.patient)
    desk.requests.submit(Request(refuse, lambda reply: desk.replies.append(("bad", reply))), may_wait=True)
    desk.release.set()
    desk.until(lambda: len(desk.replies) == 2)
    assert desk.replies[1][1].code == "configuration"
    assert not desk.requests.busy


def test_the_share_that_is_done_never_decreases(desk):
    steps = [
        ("Reading", 0.0), ("Accumulating", 0.2), ("Accumulating, 0.2 million samples/s", 0.9), ("Solving", None),
        ("Solving", None), ("Accumulating", 0.1), ("Writing", None),
    ]  # fmt: skip

    def job(tell):
        for what, share in steps:
            tell(what, share)
            time.sleep(0.05)
        return DONE

    desk.submit("first", job)
    desk.until(lambda: desk.replies)
    stages = [stage for _, stage in desk.stages]
    shares = [stage.share for stage in stages]
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < 0.3
    assert 0.9 < shares[-1] <= 1.0
    assert list(dict.fromkeys(stage.name for stage in stages)) == [
        "Reading", "Accumulating", "Solving", "Writing"
    ]  # fmt: skip
    assert all(isinstance(stage, Stage) and stage.sentence.endswith("% done.") for stage in stages)


def test_each_stage_is_told_however_short_and_the_rest_at_the_pace():
    desk, rest = Desk(pace=60.0), threading.Event()

    def job(tell):
        tell("waiting", 0.0)
        for share in (0.2, 0.4, 0.6):
            tell("trajectory", share)
        tell("stopping", None)
        rest.wait(60.0)
        tell("identifying", None)
        return DONE

    desk.submit("first", job)
    desk.until(lambda: len(desk.stages) == 3)
    desk.requests.look()
    rest.set()
    desk.until(lambda: desk.replies)
    stages = [stage for _, stage in desk.stages]
    assert [stage.name for stage in stages] == ["waiting", "trajectory", "stopping", "identifying"]
    assert stages[1].share == pytest.approx(0.65 * 0.2), "where it began"


def test_work_in_threads_is_cancelled_between_its_items():
    """As the slow steps of method full are: they report nothing else."""
    worked = []

    def work(item):
        worked.append(item)
        time.sleep(0.01)

    desk = Desk()

    def job(_):
        threads.in_threads(work, range(2000))
        return DONE

    request = desk.submit("first", job)
    desk.until(lambda: len(worked) > 5)
    start = time.monotonic()
    desk.requests.cancel(request, CANCELLED)
    desk.until(lambda: desk.replies)
    assert desk.replies == [("first", CANCELLED)]
    assert time.monotonic() - start < 2.0
    desk.until(lambda: not desk.requests.findings())  # it ends, it is not just left alone
    assert len(worked) < 1000
