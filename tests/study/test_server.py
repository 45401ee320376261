"""A study's server with a hall that only listens: from consent to the code, and who sees what."""

import contextlib
import io
import json
import time
import zipfile

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from gpcjax.errors import UserError
from gpcjax.study import reception, sitting
from gpcjax.study.register import Register
from gpcjax.study.server import PAGE, Serving, host_of, token_of
from gpcjax.teach.door import HEADERS
from tests.serving import LONG, InThread
from tests.study.example import study_with
from tests.study.halls import FakeHall


class Running(InThread):
    """A server of a study; `client` makes pages."""

    def __init__(self, out, study, places=64, host="127.0.0.1", address=None):
        self.hall, self.out, self._pages = FakeHall(places), out, contextlib.ExitStack()
        self.register = Register(out, study)
        serving = Serving(self.register, self.hall, places, host, 0, address)
        super().__init__(serving, serving.server, serving.socket.getsockname()[1])

    def end(self):
        self._pages.close()
        super().end()
        assert self.raised is None

    def opens(self, path="/part", **options):
        return self.socket(path, **options)

    def looks(self):
        """The experimenter's page."""
        cookie = f"gpcjax-experimenter={self.serving.token}"
        return self._paged(self.opens("/experimenter/live", additional_headers={"Cookie": cookie}))

    def _paged(self, opened):
        page = Client(opened)
        self._pages.callback(page.close)
        return page

    def client(self, code="alpha", take=False):
        page = self._paged(self.opens())
        page.until("hello")
        page.says("join", code=code, take=take)
        return page

    def seat(self, *, before=()):
        """The one seat that is taken, or the one beside those."""
        end = time.monotonic() + LONG
        while True:
            with self.hall.lock:
                new = [each for each in self.hall.seats if each not in before]
            if new:
                return new[-1]
            assert time.monotonic() < end
            time.sleep(0.005)


class Client:
    def __init__(self, opened):
        self._open, self.told = contextlib.ExitStack(), []
        self.socket = self._open.enter_context(opened)

    def says(self, type_, **content):
        self.socket.send(json.dumps({"type": type_, **content}))

    def hears(self):
        message = json.loads(self.socket.recv(timeout=LONG))
        self.told.append(message)
        return message

    def until(self, type_, **wanted):
        while not ((message := self.hears())["type"] == type_ and wanted.items() <= message.items()):
            pass
        return message

    def closed(self):
        with pytest.raises(ConnectionClosed):
            while True:
                self.hears()
        return self.told[-1]

    def close(self):
        self._open.close()

    def presses(self, dim=0, h=1, held=False):
        self.says("press", id=1, dim=dim, h=h, n=1, at=5.0, held=held)

    def to_trial(self):
        self.until("step", kind="consent")
        self.says("agree", on=True)
        self.until("step", kind="check")
        self.says("measured", width=900, height=700, frame_rate=60, round_trip=3)
        self.until("step", kind="instructions")
        self.says("go_on")
        self.until("step", kind="trial")
        self.until("frame")

    def to_first_run(self):
        self.to_trial()
        self.says("pause", on=False)
        self.until("state", paused=False)
        for h in (-1, 1):
            self.presses(h=h)
        self.until("step", kind="run")
        self.until("frame")

    def does_runs_until_questions(self, running):
        """Each run as soon as it is offered; gives how many there were."""
        for count in range(1, 100):
            seat = running.seat()
            self.says("pause", on=False)
            self.until("state", paused=False)
            self.presses()
            seat.over()
            if self.until("step")["kind"] == "questions":
                return count
            self.until("frame")
        raise AssertionError


@pytest.fixture(autouse=True)
def seconds_are_short(monkeypatch):
    """Between two looks at whose time has run out."""
    monkeypatch.setattr(reception, "SECOND", 0.05)


@pytest.fixture
def make(tmp_path):
    made = []

    def make_(old="", new="", **options):
        running = Running(*study_with(tmp_path, old, new), **options)
        made.append(running)
        return running

    yield make_
    for each in made:
        each.end()


@pytest.fixture
def running(make):
    return make()


def until(true):
    end = time.monotonic() + LONG
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


# --- the whole way


def test_from_consent_to_the_code(running):
    page = running.client()
    page.to_first_run()
    for _ in range(4):
        assert page.does_runs_until_questions(running) == 2
        page.says("answers", values={"easy": 5})
        page.until("step") if _ < 3 else None
        if _ < 3:
            page.until("frame")
    page.until("step", name="questions-end")
    page.says("answers", values={"remarks": "<b>fine</b>"})
    ended = page.until("ended")
    assert ended["code"] == "C0FFEE" and ended["link"] == "https://example.org/back?who=alpha"
    assert running.register.get("alpha").kept.state == "complete"
    (card,) = running.out.glob("participants/*/participant.json")
    kept = json.loads(card.read_bytes())
    assert kept["state"] == "complete" and len(kept["answers"]) == 5
    assert sorted(path.name for path in (card.parent / "runs").iterdir()) == [
        "01-dummy-A-pendulum", "02-recorded-A-pendulum", "03-dummy-B-pendulum", "04-recorded-B-pendulum",
        "05-dummy-A-cartpole", "06-recorded-A-cartpole", "07-dummy-B-cartpole", "08-recorded-B-cartpole",
    ]  # fmt: skip
    before = [message for message in page.told if message["type"] != "ended"]
    assert "C0FFEE" not in json.dumps(before), "nobody reads the code before the end"


def test_a_page_learns_nothing_of_the_learner(running):
    page = running.client()
    page.to_first_run()
    seat = running.seat()
    for kind in ("advised", "undone", "lines", "map", "saved", "episode", "state", "problem"):
        told = {
            "learner": "gpc",
            "rate": 0.3,
            "points": [1, 2],
            "text": "gpc failed",
            "total": 1.0,
            "paused": True,
        }
        seat.say({"type": kind, **told, "sigma_human": 0.2, "folder": "x"})
    page.says("ping", at=1)
    page.until("pong")
    text = json.dumps([each for each in page.told if each["type"] not in ("hello", "step")])
    assert not any(
        word in text for word in ("gpc", "coach", "GPC", "points", 'rate"', "sigma_human", "folder", "credit")
    )
    assert all(
        each["sigma"] is None and each["prior"] is None for each in page.told if each["type"] == "frame"
    )
    steps = json.dumps([each for each in page.told if each["type"] == "step"])
    assert "gpc" not in steps and "coach" not in steps
    assert {each["type"] for each in page.told} <= {
        "hello", "step", "held", "task", "ready", "state", "frame", "needed", "advised", "episode", "problem", "pong",
    }  # fmt: skip


def test_the_cue_is_there_in_its_arm_alone(make):
    arm = "[[arms]]\nname = 'cue'\ncue = true\nlearners = ['gpc']\n[[learners]]"
    running = make("[[learners]]", arm)
    page = running.client()
    page.to_first_run()
    assert page.told[-1]["sigma"] == [0.4] and running.seat().run.cue


def test_a_run_is_what_the_order_says(running):
    page = running.client()
    page.to_first_run()
    one, run = running.register.get("alpha"), running.seat().run
    assert run.folder == one.folder / "runs" / "01-dummy-A-pendulum"
    assert run.course.algo == one.letters["A"].learner and run.course.env == "pendulum"
    assert run.course.seed == one.seed + 1 and run.episodes == 2 and run.seconds == 900


def test_late_arms_hold_presses_back(make):
    running = make("[[learners]]", "[[arms]]\nname = 'late'\ndelay = 0.3\n[[learners]]")
    page = running.client()
    page.to_first_run()
    seat = running.seat()
    page.says("pause", on=False)
    page.until("state", paused=False)
    page.presses()
    page.says("ping", at=1)
    page.until("pong")
    assert seat.presses == []
    until(lambda: len(seat.presses) == 1)


# --- what is not passed


def test_no_consent(running):
    page = running.client()
    page.until("step")
    page.says("agree", on=False)
    ended = page.until("ended")
    assert ended["state"] == "declined" and ended["code"] is None and ended["link"] is None
    assert running.register.free == 4


def test_a_machine_that_is_not_enough_is_told_why(running):
    page = running.client()
    page.until("step")
    page.says("agree", on=True)
    page.until("step", kind="check")
    page.says("measured", width=200, height=700, frame_rate=60, round_trip=900)
    told = page.until("step", kind="check")["wrong"]
    assert len(told) == 2 and "200 pixels, 300 are needed" in told[0] and "900 ms" in told[1]
    page.says("measured", width=300, height=700, frame_rate=60, round_trip=9)
    page.until("step", kind="instructions")


def test_the_trial_has_its_attempts(running):
    page = running.client()
    page.to_trial()
    first = running.seat()
    first.over()
    assert page.until("step", kind="trial")["attempt"] == 2
    page.until("frame")
    second = running.seat(before=[first])
    assert second.run.folder.name == "2" and first.left
    second.over()
    assert page.until("ended")["state"] == "failed"


def test_a_trial_of_a_return(make):
    running = make("presses = 1", 'passes = "return"\nreturn = 100')
    page = running.client()
    page.to_trial()
    seat = running.seat()
    seat.say(
        {
            "type": "episode",
            "index": 0,
            "total": 99.0,
            "steps": 99,
            "corrections": 0,
            "mode": "teach",
            "why": "over",
        }
    )
    page.until("episode")
    seat.say(
        {
            "type": "episode",
            "index": 1,
            "total": 100.0,
            "steps": 9,
            "corrections": 0,
            "mode": "teach",
            "why": "over",
        }
    )
    page.until("step", kind="run")


def test_answers_that_are_none_are_told(running):
    page = running.client()
    page.to_first_run()
    page.does_runs_until_questions(running)
    page.says("answers", values={"easy": 8})
    assert "1 to 7" in page.until("problem")["text"]
    page.says("answers", values={})
    assert "needed" in page.until("problem")["text"]
    page.says("answers", values={"easy": 7})
    page.until("step", kind="run")


def test_no_code_before_all_is_on_the_disk(running, monkeypatch):
    page = running.client()
    page.to_first_run()
    one = running.register.get("alpha")
    one.kept.step = len(one.steps) - 1
    page.close()
    page = running.client()
    page.until("step", name="questions-end")

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("gpcjax.study.participant.write_atomic", full)
        page.says("answers", values={})
        assert "technical problem" in page.until("problem")["text"]
        again = running.client(take=True)
        assert again.until("step")["name"] == "questions-end"
    again.says("answers", values={})
    assert again.until("ended")["code"] == "C0FFEE"


# --- coming back


def test_a_reload_is_at_the_same_step_and_seat(running):
    page = running.client()
    page.to_first_run()
    seat = running.seat()
    page.says("pause", on=False)
    page.until("state", paused=False)
    page.close()
    until(lambda: seat.why == "connection")
    again = running.client()
    assert again.until("step")["name"] == "01-dummy-A-pendulum"
    assert again.until("state")["why"] == "connection"
    assert running.seat() is seat and not seat.left


def test_after_a_crash_it_goes_on_in_the_same_run(make, tmp_path):
    first = make()
    page = first.client()
    page.to_first_run()
    first.seat().over()
    page.until("step", name="02-recorded-A-pendulum")
    page.until("frame")
    before = first.seat().run
    page.close()
    first.end()
    second = make()
    page = second.client()
    assert page.until("step")["name"] == "02-recorded-A-pendulum"
    page.until("frame")
    assert second.seat().run == before
    first.serving.server.should_exit = True


def test_a_second_page_may_take_over(running):
    page = running.client()
    page.until("step")
    other = running.client()
    other.until("elsewhere")
    other.says("agree", on=True)
    other.says("join", code="alpha", take=True)
    assert other.until("step")["kind"] == "consent", "what it said before does not count"
    assert page.closed() == {"type": "gone", "reason": "took over"}


def test_a_run_rests_when_another_page_takes_over(running):
    page = running.client()
    page.to_first_run()
    page.says("pause", on=False)
    page.until("state", paused=False)
    other = running.client(take=True)
    assert other.until("state")["why"] == "connection"
    assert page.closed()["type"] == "gone" and running.seat().paused


def test_a_seat_that_is_left_is_given_to_others(make, monkeypatch):
    monkeypatch.setattr(sitting, "GRACE", 0.2)
    monkeypatch.setattr(sitting, "AGAIN", 0.1)
    running = make(places=1)
    one, two = running.client("one"), running.client("two")
    one.to_trial()
    two.until("step")
    two.says("agree", on=True)
    two.until("step")
    two.says("measured", width=900, height=700, frame_rate=60, round_trip=3)
    two.until("step")
    two.says("go_on")
    two.until("waiting")
    one.close()
    two.until("frame")
    one = running.client("one")
    one.until("waiting")


def test_what_nobody_watches_rests(make):
    running = make("rest = 0", "rest = 0\nidle = 0.3")
    page = running.client()
    page.to_first_run()
    seat = running.seat()
    page.says("pause", on=False)
    page.until("state", paused=False)
    assert page.until("state", paused=True)["why"] == "idle"
    page.says("pause", on=False)
    page.until("state", paused=False)
    page.says("hidden", on=True)
    assert page.until("state", paused=True)["why"] == "away"
    page.says("pause", on=False)
    page.says("hidden", on=False)
    page.says("pause", on=False)
    page.until("state", paused=False)
    page.presses()
    until(lambda: len(seat.presses) == 1)
    lines = (running.register.get("alpha").folder / "log.jsonl").read_text().splitlines()
    log = [json.loads(line)["event"] for line in lines]
    assert {"idle", "away", "back"} <= set(log)


def test_a_rest_between_runs_is_kept(make):
    running = make("rest = 0", "rest = 600")
    page = running.client()
    page.to_first_run()
    seat = running.seat()
    page.says("pause", on=False)
    page.until("state", paused=False)
    seat.over()
    assert page.until("step", kind="run")["rest"] > 500
    page.until("frame")
    page.says("pause", on=False)
    page.says("ping", at=1)
    page.until("pong")
    assert running.seat(before=[seat]).paused


# --- who may not


def test_codes_that_are_none_and_a_full_study(make):
    running = make("participants = 4", "participants = 1")
    page = running.client("<script>")
    assert "no code" in page.until("refused")["text"]
    page.says("join", code="one", take=False)
    page.until("step")
    assert "All places" in running.client("two").until("refused")["text"]
    assert not any("script" in path.read_text() for path in running.out.rglob("*.json"))


def test_one_page_may_not_try_many_codes(running):
    page = running.client("<")
    for _ in range(reception.MOST_TRIES):
        page.says("join", code="<", take=False)
    assert "too many" in page.closed()["reason"]


def test_new_participants_come_at_a_rate(make):
    running = make("[completed]", "[joining]\na_minute = 1\n[completed]")
    running.client("one").until("step")
    assert "Too many" in running.client("two").until("refused")["text"]
    again = running.client("one")
    again.until("elsewhere")


def test_another_host_or_page_is_refused(running):
    assert running.asks("/", Host="evil.example")[0] == 421
    for origin in (None, "null", "https://evil.example", "http://127.0.0.1:1"):
        with pytest.raises(InvalidStatus), running.opens(origin=origin):
            pass


def test_behind_a_proxy_only_its_name_and_only_encrypted(make):
    running = make(address="https://study.example.org")
    assert running.serving.address == "https://study.example.org/"
    assert running.asks("/", Host="study.example.org")[0] == 200
    assert running.asks("/", Host="other.example.org")[0] == 421
    options = {"additional_headers": {"Host": "study.example.org"}}
    for origin, enters in (("https://study.example.org", True), ("http://study.example.org", False)):
        with contextlib.ExitStack() as stack:
            if not enters:
                stack.enter_context(pytest.raises(InvalidStatus))
            page = stack.enter_context(_to_host(running, origin, **options))
            assert json.loads(page.recv(timeout=LONG))["type"] == "hello"
    status, headers, _ = running.asks(
        f"/experimenter?token={running.serving.token}", Host="study.example.org"
    )
    cookie = headers["set-cookie"].lower()
    assert status == 303 and "secure" in cookie and "httponly" in cookie and "path=/experimenter" in cookie


def _to_host(running, origin, additional_headers):
    import socket

    raw = socket.create_connection(("127.0.0.1", running.port))
    host = additional_headers["Host"]
    return connect(f"ws://{host}/part", sock=raw, origin=origin, compression=None, proxy=None)


@pytest.mark.parametrize(
    "address", ["http://a.org", "a.org", "https://", "https://a.org/x", "https://u@a.org", "https://a.org:x"]
)
def test_an_address_that_is_none(address):
    with pytest.raises(UserError, match="give https://HOST"):
        host_of(address, "--address")


def test_every_file_is_served_with_all_headers(running):
    paths = ["/", *(f"/study/{path.name}" for path in sorted(PAGE.iterdir())), "/page/stage.js"]
    for path in paths:
        status, headers, content = running.asks(path)
        assert status == 200 and HEADERS.items() <= headers.items() and content
    for path in (
        "/study/../reception.py",
        "/study/%2e%2e/reception.py",
        "/lesson",
        "/study.toml",
        "/participants/p0001",
        "/token",
    ):
        assert running.asks(path)[0] == 404
    assert running.asks("/", "POST")[0] == 405


# --- the experimenter


@pytest.mark.parametrize(
    "path", ["/experimenter", "/experimenter/download", "/experimenter/", "/experimenter?token=no"]
)
def test_without_the_token_nobody_looks(running, path):
    assert running.asks(path)[0] == 403
    assert running.asks(path, Cookie="gpcjax-experimenter=no")[0] == 403


def test_the_token_is_kept_and_its_owners_alone(running):
    assert token_of(running.out) == running.serving.token
    assert (running.out / "token").stat().st_mode & 0o777 == 0o600
    with pytest.raises(InvalidStatus), running.opens("/experimenter/live"):
        pass


def test_the_experimenter_sees_who_is_where_pauses_and_stops(running):
    page = running.client()
    page.to_first_run()
    look = running.looks()
    row = look.until("people")["rows"][0]
    assert row["code"] == "alpha" and row["here"] and row["step"] == "01-dummy-A-pendulum"
    assert row["lesson"]["step"] == 7 and row["lesson"]["why"] == "start"
    running.seat().say({"type": "problem", "text": "the disk is full"})
    until(lambda: look.hears()["rows"][0]["problem"] == "the disk is full")
    page.says("pause", on=False)
    page.until("state", paused=False)
    look.says("pause", code="alpha", on=True)
    page.until("held", on=True)
    assert page.until("state", paused=True)["why"] == "experimenter"
    page.says("pause", on=False)
    look.says("pause", code="alpha", on=False)
    page.until("held", on=False)
    page.says("pause", on=False)
    page.until("state", paused=False)
    look.says("pause", code="", on=True)
    page.until("held", on=True)
    look.says("stop", code="alpha")
    assert page.until("ended")["state"] == "stopped"
    assert running.hall.seats == [] and running.register.free == 4


def test_a_participant_is_deleted_while_it_runs(running):
    page = running.client()
    page.to_first_run()
    look = running.looks()
    look.says("delete", code="alpha")
    assert "p0001" in look.until("deleted")["removed"][0]
    with pytest.raises(ConnectionClosed) as closed:
        while True:
            page.hears()
    # That it goes could not be written any more, and what the hall writes when it is left comes before.
    assert page.told[-1]["type"] == "gone" and closed.value.rcvd.code == 1000
    assert [(folder.name, *rest) for folder, *rest in running.hall.awaited] == [("p0001", True, [])]
    assert not any(running.out.glob("participants/p*")) and look.until("people")["rows"] == []
    look.says("delete", code="alpha")
    assert "nobody" in look.until("problem")["text"]


def test_who_is_deleted_on_a_full_disk_is_gone(running, monkeypatch):
    """Of whom no end can be written: page and seat go all the same, and nobody ticks for them."""
    page = running.client()
    page.to_first_run()

    def full(participant):
        raise OSError(28, "No space left on device")

    look = running.looks()
    with monkeypatch.context() as patch:
        patch.setattr("gpcjax.study.participant.Participant.save", full)
        look.says("delete", code="alpha")
        assert "p0001" in look.until("deleted")["removed"][0]
    assert page.closed()["type"] == "gone" and running.hall.seats == []
    assert not any(running.out.glob("participants/p*"))


def test_a_page_is_told_that_its_time_has_run_out(running, monkeypatch):
    """Who comes in later ends those who are late: a page of theirs would go on, and its seat be taken."""
    page = running.client()
    page.to_first_run()
    (one,) = running.register
    one.end("expired")
    assert page.until("ended")["state"] == "expired"
    assert running.hall.seats == []


def test_what_goes_wrong_with_one_is_nothing_to_others(running, monkeypatch):
    page, other = running.client("alpha"), running.client("beta")
    page.to_first_run()
    other.to_first_run()
    alpha, beta = running.register
    tick = sitting.Sitting.tick

    async def fails(one):
        if one.participant is alpha:
            raise RuntimeError("not this one")
        return await tick(one)

    monkeypatch.setattr(sitting.Sitting, "tick", fails)
    beta.end("expired")
    assert other.until("ended")["state"] == "expired"
    assert "RuntimeError: not this one" in running.looks().until("people")["faults"]


def test_a_page_goes_though_that_cannot_be_written(running, monkeypatch):
    page = running.client()
    page.to_first_run()

    def full(participant):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gpcjax.study.participant.Participant.save", full)
    other = running.client(take=True)
    other.until("frame")
    with pytest.raises(ConnectionClosed) as closed:
        while True:
            page.hears()
    assert closed.value.rcvd.code == 1000
    other.close()
    look = running.looks()
    assert any("No space" in look.until("people")["rows"][0]["problem"] for _ in range(20))


def test_the_download_has_all_but_the_token(running):
    page = running.client()
    page.to_first_run()
    running.seat().over()
    page.until("step", name="02-recorded-A-pendulum")
    status, headers, content = running.asks(
        "/experimenter/download", Cookie=f"gpcjax-experimenter={running.serving.token}"
    )
    assert status == 200 and headers["content-type"] == "application/zip"
    archive = zipfile.ZipFile(io.BytesIO(content))
    assert archive.testzip() is None
    names = set(archive.namelist())
    assert {
        "out/study.toml", "out/participants/p0001/participant.json", "out/participants/p0001/log.jsonl",
        "out/participants/p0001/runs/01-dummy-A-pendulum/session.jsonl",
    } <= names  # fmt: skip
    assert not any("token" in name or "lock" in name for name in names)
    assert running.serving.token.encode() not in content


def test_the_report_is_made_on_demand_and_runs_nothing(running):
    cookie = f"gpcjax-experimenter={running.serving.token}"
    status, _, told = running.asks("/experimenter/report", Cookie=cookie)
    assert status == 503 and b"nobody has come yet" in told
    page = running.client()
    page.to_first_run()
    assert running.asks("/experimenter/report")[0] == 403
    status, headers, content = running.asks("/experimenter/report", Cookie=cookie)
    assert status == 200 and b"No recorded run" in content and b"alpha" not in content
    policy = headers["content-security-policy"]
    assert "script" not in policy and policy.startswith("default-src 'none'; style-src 'unsafe-inline'")
    assert headers["x-content-type-options"] == "nosniff" and (running.out / "analysis").is_dir()


def test_no_address_of_anybody_is_kept(running):
    page = running.client()
    page.to_first_run()
    page.says("leave")
    page.until("ended")
    for path in running.out.rglob("*"):
        if path.is_file():
            assert "127.0.0.1" not in path.read_text() and "Python/" not in path.read_text()
