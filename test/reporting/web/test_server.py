"""The server over HTTP, without a browser: what it serves, and to whom; and the feed of the live page."""

from __future__ import annotations

import asyncio
import json
import sys

import pytest

testclient = pytest.importorskip("starlette.testclient", reason="the extra web is not installed")

from drive_id.reporting.web.server import Feed, application  # noqa: E402  # needs the extra

HOST = {"host": "127.0.0.1:8080"}


@pytest.fixture
def root(fitted, tmp_path):
    (tmp_path / "secret.txt").write_text("secret")
    fitted.save(tmp_path / "results" / "a b", draw=False)
    (tmp_path / "results" / "a b" / "report.html").write_text("a report")
    (tmp_path / "results" / "a b" / "notes.txt").write_text("mine")
    (tmp_path / "results" / "report.html").symlink_to(tmp_path / "secret.txt")
    return tmp_path / "results"


def client(root, **options):
    return testclient.TestClient(application(root, live=False, **options), headers=HOST, follow_redirects=False)


def test_the_archive_and_named_files_are_served(root):
    with client(root) as http:
        page = http.get("/")
        assert page.status_code == 200
        assert '"folder": "a b"' in page.text
        assert 'href="live"' not in page.text
        assert page.headers["cache-control"] == "no-store"
        assert http.get("/a%20b/report.html").text == "a report"
        assert json.loads(http.get("/a%20b/identification.json").text)["method"] == "joint"


@pytest.mark.parametrize(
    "path",
    ["/a%20b/notes.txt", "/a%20b/flux_map.npz", "/../secret.txt", "/%2e%2e/secret.txt", "/a%20b/..%2f..%2fsecret.txt",
     "/report.html", "/nowhere/report.html", "/live", "/events"],
)  # fmt: skip
def test_nothing_else_is_served(root, path):
    with client(root) as http:
        assert http.get(path).status_code == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_it_is_read_only(root, method):
    with client(root) as http:
        assert http.request(method, "/").status_code == 405
        assert http.request(method, "/a%20b/report.html").status_code == 405


def test_without_a_token_only_this_computers_name_is_answered(root):
    """A page elsewhere whose name was rebound to 127.0.0.1 sends its own name."""
    with client(root) as http:
        assert http.get("/", headers={"host": "evil.example:8080"}).status_code == 400
        assert http.get("/", headers={"host": "localhost:8080"}).status_code == 200


def test_with_a_token_nothing_is_served_without_it(root):
    with client(root, token="right") as http:
        for path in ("/", "/a%20b/report.html", "/?token=wrong", "/nowhere"):
            answer = http.get(path, headers={"host": "bench:8080"})
            assert answer.status_code == 401
            assert "a b" not in answer.text
        assert http.get("/", headers={"authorization": "Bearer right"}).status_code == 200
        first = http.get("/?token=right")
        assert (first.status_code, first.headers["location"]) == (303, "/")
        cookie = first.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        assert http.get("/").status_code == 200


async def first_events(feed, count, until=lambda _: True):
    events = []
    async for text in feed.news():
        event = json.loads(text.removeprefix("data: "))
        if until(event):
            events.append(event)
        if len(events) == count:
            break
    return events


def test_a_page_that_comes_late_gets_the_whole_state():
    async def scenario():
        feed = Feed([])
        feed.take({"points": [[1, 2]], "speed": 3.0})
        feed.take({"points": [[4, 5]], "speed": 6.0})
        return await first_events(feed, 1)

    assert asyncio.run(scenario()) == [{"reset": True, "points": [[1, 2], [4, 5]], "speed": 6.0}]


def test_a_page_that_does_not_keep_up_gets_the_whole_state_again():
    async def scenario():
        feed = Feed([])
        slow = feed.news()
        await anext(slow)
        for number in range(200):
            feed.take({"number": number, "points": [[number, 0]]})
        return [json.loads((await anext(slow)).removeprefix("data: ")) for _ in range(2)]

    first, _ = asyncio.run(scenario())
    assert first["reset"]
    assert len(first["points"]) == first["number"] + 1 > 50


def test_a_feed_that_ends_is_started_again(monkeypatch):
    """With what its process prints; its end is said meanwhile."""
    monkeypatch.setattr("drive_id.reporting.web.server._RESTART", 0.05)
    line = "import json, os; print(json.dumps({'pid': os.getpid()}), flush=True); raise SystemExit(3)"

    async def scenario():
        feed = Feed([sys.executable, "-c", line])
        task = asyncio.create_task(feed.run())
        events = await asyncio.wait_for(first_events(feed, 4, lambda event: "reset" not in event), 60)
        task.cancel()
        return events

    started, ended, again, _ = asyncio.run(scenario())
    assert started["pid"] != again["pid"]
    assert (started["feed"], again["feed"]) == ("", "")
    assert "ended with exit code" in ended["feed"]
