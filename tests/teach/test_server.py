"""The server with a lesson that only listens: who comes in, what is served, one teacher at a time, a slow reader."""

import asyncio
import contextlib
import json
import logging
import queue
import socket
import threading
import time

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from gpcjax.errors import UserError
from gpcjax.teach import pages, room
from gpcjax.teach.door import HEADERS
from gpcjax.teach.server import PAGE, Serving, bound, configuration, is_local
from tests.serving import LONG, InThread


class Listener:
    """A lesson that keeps what it is told. `say` tells the page."""

    def __init__(self, say):
        self.say, self.heard, self.failure = say, queue.Queue(), None
        self._over = threading.Event()

    def start(self):
        pass

    def join(self):
        self._over.wait()

    def close(self):
        self._over.set()

    def submit(self, command):
        self.heard.put(command)

    def fail(self, error):
        self.failure = error
        self._over.set()

    def hears(self, kind):
        command = self.heard.get(timeout=LONG)
        assert command.type == kind
        return command


class Running(InThread):
    """A server of a lesson."""

    def __init__(self, host="127.0.0.1"):
        serving = Serving(Listener, host, 0)
        self.lesson = serving.lesson
        super().__init__(serving, serving._server, serving._socket.getsockname()[1])

    def page(self, **options):
        return self.socket("/lesson", **options)


@pytest.fixture(scope="module")
def served():
    running = Running()
    yield running
    running.end()
    assert running.raised is None


@pytest.fixture(scope="module")
def with_token():
    running = Running("0.0.0.0")
    yield running
    running.end()


@pytest.fixture
def alone(served):
    """The server, when everybody has left."""
    end = time.monotonic() + LONG
    while served.serving._room._teaching is not None:
        assert time.monotonic() < end
        time.sleep(0.01)
    time.sleep(0.02)
    while not served.lesson.heard.empty():
        served.lesson.heard.get()
    return served


def _told(page):
    return json.loads(page.recv(timeout=LONG))


def _until(page, kind):
    while (message := _told(page))["type"] != kind:
        pass
    return message


def _closed(page):
    """The messages until the connection is closed, and its code."""
    told = []
    with pytest.raises(ConnectionClosed) as closing:
        while True:
            told.append(_told(page))
    return told, closing.value.rcvd and closing.value.rcvd.code


def _says(page, **message):
    page.send(json.dumps(message))


# --- what is served


@pytest.mark.parametrize(
    "path", ["/", *(f"/page/{path.name}" for path in sorted(PAGE.iterdir()) if path.is_file())]
)
def test_every_file_of_the_page_is_served_with_all_headers(served, path):
    status, headers, content = served.asks(path)
    assert (
        status == 200
        and content == (PAGE / (path.removeprefix("/page/").strip("/") or "index.html")).read_bytes()
    )
    assert HEADERS.items() <= headers.items()


@pytest.mark.parametrize(
    "path",
    ["/nothing", "/page/", "/page/../server.py", "/page/..%2fserver.py", "/page/%2e%2e/server.py", "/page/..",
     "/page/..%5cserver.py", "/page//etc/passwd", "/page/%2fetc%2fpasswd", "/page/%00.js", "/page/%ff.js",
     "/page/nothing.js", "/page/" + "a" * 300 + ".js", "/page/.js", "/lesson"],
)  # fmt: skip
def test_nothing_else_is_there(served, path):
    status, headers, content = served.asks(path)
    assert status == 404 and b"import" not in content and HEADERS.items() <= headers.items()


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"])
def test_it_is_only_read(served, method):
    status, headers, _ = served.asks("/", method)
    assert status == 405 and HEADERS.items() <= headers.items()


def test_another_host_is_refused(served):
    for host in ("evil.example", f"evil.example:{served.port}", "127.0.0.1", f"127.0.0.1.evil:{served.port}"):
        status, headers, _ = served.asks("/", Host=host)
        assert status == 421 and HEADERS.items() <= headers.items()
    for host in ("localhost", "LOCALHOST", "[::1]"):
        assert served.asks("/", Host=f"{host}:{served.port}")[0] == 200


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "http://127.0.0.1", "http://127.0.0.1:1"]
)
def test_a_page_from_elsewhere_is_refused(served, origin):
    with pytest.raises(InvalidStatus) as refused, served.page(origin=origin):
        pass
    assert refused.value.response.status_code == 403


# --- the token


def test_beyond_this_machine_only_with_the_token(with_token):
    token = with_token.serving.token
    for path, headers in (
        ("/", {}), ("/page/style.css", {}), (f"/page/style.css?token={token}", {}), ("/?token=", {}),
        ("/?token=%ff%00", {}), (f"/?token={token}a", {}), ("/", {"Cookie": f"gpcjax-token-{with_token.port}=no"}),
    ):  # fmt: skip
        status, answered, _ = with_token.asks(path, **headers)
        assert status == 403 and HEADERS.items() <= answered.items()
    status, answered, _ = with_token.asks(f"/?token={token}")
    assert status == 303 and answered["location"] == "/"
    cookie = answered["set-cookie"]
    assert "httponly" in cookie.lower() and "samesite=strict" in cookie.lower()
    kept = cookie.partition(";")[0]
    assert with_token.asks("/", Cookie=kept)[0] == 200
    with pytest.raises(InvalidStatus), with_token.page():
        pass
    with with_token.page(additional_headers={"Cookie": kept}) as page:
        assert _told(page)["type"] == "hello"
    with (
        pytest.raises(InvalidStatus),
        with_token.page(origin="http://evil", additional_headers={"Cookie": kept}),
    ):
        pass


def test_without_a_token_only_on_this_machine():
    assert all(map(is_local, ("127.0.0.1", "localhost", "::1", "127.8.9.1")))
    assert not any(map(is_local, ("0.0.0.0", "::", "10.0.0.1", "example.org", "")))


# --- one page teaches


def test_a_page_is_greeted_and_its_words_are_heard(alone):
    with alone.page() as page:
        assert _told(page) == {"type": "hello", "version": room.gpcjax.__version__, "taken": False}
        alone.lesson.hears("joined")
        _says(page, type="pause", on=False)
        assert alone.lesson.hears("pause").values == {"on": False}
        page.send(b'{"type":"undo"}')
        alone.lesson.hears("undo")
        _says(page, type="ping", at=4.5)
        assert _until(page, "pong") == {"type": "pong", "at": 4.5}
    alone.lesson.hears("left")


def test_a_second_page_waits_until_it_takes_over(alone):
    with alone.page() as first, alone.page() as second:
        assert _told(first)["taken"] is False
        assert _told(second)["taken"] is True
        alone.lesson.hears("joined")
        _says(second, type="undo")
        _says(second, type="ping", at=1)
        assert _told(second)["type"] == "pong", "it is told nothing of the lesson"
        _says(second, type="take")
        alone.lesson.hears("left")
        alone.lesson.hears("joined")
        told, code = _closed(first)
        assert told[-1] == {"type": "gone", "reason": "took over"} and code == 1000
        alone.lesson.say({"type": "ready"})
        _until(second, "ready")
        _says(second, type="take")
        _says(second, type="step")
        alone.lesson.hears("step")
    alone.lesson.hears("left")
    assert alone.lesson.heard.empty(), "the first page's end is no end of the second"


def test_a_lost_connection_is_told_and_the_next_page_is_greeted(alone):
    page = alone.page()
    alone.lesson.hears("joined")
    page.socket.shutdown(socket.SHUT_RDWR)
    alone.lesson.hears("left")
    with alone.page() as again:
        assert _told(again)["taken"] is False
        alone.lesson.hears("joined")


def test_nothing_follows_the_end(alone):
    with alone.page() as page:
        alone.lesson.hears("joined")
        ours = alone.serving._room._teaching
        alone.serving._room._loop.call_soon_threadsafe(
            lambda: (
                ours.close("over"),
                ours.put({"type": "ready"}),
                ours.put({"type": "frame"}),
                ours.put(b"picture"),
            )
        )
        assert _closed(page)[0][-1] == {"type": "gone", "reason": "over"}


# --- what is too much


def test_a_page_that_talks_nonsense_is_sent_away(alone):
    with alone.page() as page:
        alone.lesson.hears("joined")
        for _ in range(pages.MOST_REFUSED):
            page.send("nonsense")
        _says(page, type="step")
        alone.lesson.hears("step")
        page.send("nonsense")
        told, _ = _closed(page)
        assert told[-1]["type"] == "gone" and "refused" in told[-1]["reason"]
    alone.lesson.hears("left")


def test_a_page_that_talks_too_much_is_sent_away(alone):
    with alone.page() as page:
        alone.lesson.hears("joined")
        with contextlib.suppress(ConnectionClosed):
            for _ in range(20 * pages.MOST_MESSAGES):
                _says(page, type="step")
        told, _ = _closed(page)
        assert told[-1]["type"] == "gone" and "too many" in told[-1]["reason"]


def test_a_message_without_end_closes_the_connection(alone):
    with alone.page() as page:
        alone.lesson.hears("joined")
        page.send("x" * 100_000)
        assert _closed(page)[1] == 1009
    alone.lesson.hears("left")


def test_the_newest_frame_is_sent_and_all_else_in_order(alone):
    with alone.page() as page:
        alone.lesson.hears("joined")
        for n in range(400):
            alone.lesson.say({"type": "frame", "n": n})
            alone.lesson.say(bytes([n % 256]))
            if n % 4 == 0:
                alone.lesson.say({"type": "advised", "id": n})
        ids, frames, n = [], [], -1
        while n != 399 or len(ids) < 100:
            message = page.recv(timeout=LONG)
            if isinstance(message, str) and (read := json.loads(message))["type"] == "frame":
                n = read["n"]
                frames.append(n)
            elif isinstance(message, str) and read["type"] == "advised":
                ids.append(read["id"])
        assert ids == list(range(0, 400, 4)) and frames == sorted(set(frames)) and len(frames) < 100


def test_a_number_that_json_does_not_know_is_null(alone):
    """A browser would read nothing of such a message."""
    with alone.page() as page:
        alone.lesson.hears("joined")
        odd = {"type": "episode", "total": float("nan"), "each": [1.5, float("inf"), {"rate": -float("inf")}]}
        alone.lesson.say(odd)
        assert _until(page, "episode") == {
            "type": "episode",
            "total": None,
            "each": [1.5, None, {"rate": None}],
        }


def test_a_page_that_does_not_read_is_left(alone):
    with alone.page(max_queue=1, close_timeout=0.2) as page:
        alone.lesson.hears("joined")
        ours = alone.serving._room._teaching
        page.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        big = "x" * 20_000
        for n in range(3000):
            alone.lesson.say({"type": "advised", "id": n, "text": big})
            if n % 50 == 0:
                time.sleep(0.005)
        alone.lesson.hears("left")
        assert ours.slow.is_set() and len(ours._waiting) <= pages.MOST_WAITING


# --- the end


def test_a_lesson_that_fails_ends_the_server_and_its_page_hears_why():
    running = Running()
    with running.page() as page:
        running.lesson.hears("joined")
        running.lesson.say({"type": "gone", "reason": "damaged"})
        running.lesson.fail(UserError("damaged"))
        assert {"type": "gone", "reason": "damaged"} in _closed(page)[0]
    running.ended()
    assert isinstance(running.raised, UserError)


def test_all_pages_hear_why_before_a_server_ends_that_looks_at_once(monkeypatch):
    """As if each of its looks came between what is said and what is sent, even to a page that only waits."""
    delivered = room.Room._deliver

    def late(self, message):
        asyncio.get_running_loop().call_later(0.3, delivered, self, message)

    running = Running()
    with running.page() as page, running.page() as other:
        running.lesson.hears("joined")
        _until(other, "hello")
        monkeypatch.setattr(room.Room, "_deliver", late)
        running.lesson.say({"type": "gone", "reason": "damaged"})
        running.lesson.fail(UserError("damaged"))
        for each in (page, other):
            told, code = _closed(each)
            assert told[-1] == {"type": "gone", "reason": "damaged"} and code == 1000
    running.ended()


def test_a_port_in_use_is_said_or_the_next_one_taken():
    taken = bound("127.0.0.1", 0, 1)
    number = taken.getsockname()[1]
    with contextlib.closing(taken):
        with pytest.raises(UserError, match=f"--port {number}"):
            bound("127.0.0.1", number, 1)
        if number < 65_000:
            with contextlib.closing(bound("127.0.0.1", number, 20)) as other:
                assert number < other.getsockname()[1] < number + 20


@pytest.mark.parametrize("host", ["a" * 70, "..", "1.2.3.4", "a b"])
def test_a_host_that_is_none_is_said(host):
    with pytest.raises(UserError, match="--host"):
        bound(host, 0, 1)


def test_logging_of_others_is_left_alone():
    """uvicorn's own settings of logging close all handlers there are, and absl's closes its stream then."""
    closed = []

    class Watched(logging.NullHandler):
        def close(self):
            closed.append(self)
            super().close()

    handler = Watched()
    configuration(lambda *asked: None, 1000)
    assert not closed and not logging.getLogger("uvicorn").handlers
    handler.close()
