"""A hall without any learner: it says what it is told to say, and writes down what it hears."""

import threading
from types import SimpleNamespace

import gpcjax.study.hall  # noqa: F401  (as where a study runs: no page waits until it is loaded)
from gpcjax.errors import UserError

SECRETS = ("gpc", "coach", "learner", "folder", "learning", "sigma_human")

TASK = {
    "type": "task",
    "task": {
        "name": "cartpole",
        "label": "Cart-pole",
        "scene": "cartpole",
        "hint": "",
        "observations": [{"name": f"x{k}", "low": -2.4, "high": 2.4} for k in range(4)],
        "actions": [
            {
                "name": "force",
                "less": {"key": "left", "words": "push left"},
                "more": {"key": "right", "words": "push right"},
            }
        ],
    },
    "learner": {"name": "gpc", "label": "GPC", "settings": []},
    "learners": [{"name": "coach"}],
    "repeat": 8.0,
    "credit": 0.2,
    "folder": "/somewhere/gpc",
    "corrections": 0,
    "points": [3, 4],
    "rate": 0.5,
}


class FakeSeat:
    def __init__(self, hall, run, say):
        self.hall, self.run, self.say = hall, run, say
        self.presses, self.paused, self.why, self.left = [], True, "start", False
        self.standing = SimpleNamespace(episode=1, step=7, total=-3.5, corrections=2, why="", problem="")

    def press(self, press):
        self.presses.append(press)

    def go_on(self):
        self.paused, self.why = False, ""
        self._state()

    def pause(self, why):
        self.paused, self.why = True, why
        self._state()

    def everything(self):
        self.say(TASK)
        self.say({"type": "ready"})
        self._state()
        self.frame()

    def frame(self, n=1):
        numbers = {"episode": 0, "step": n, "obs": [0.0] * 4, "action": [0.1], "total": 1.0}
        self.say(
            {"type": "frame", "n": n, **numbers, "sigma": [0.4], "prior": 0.5, "mode": "teach", "late": 0.1}
        )

    def leave(self):
        self.left = True
        with self.hall.lock:
            self.hall.seats.remove(self)

    def over(self):
        """The run is complete and written."""
        self.run.folder.mkdir(parents=True, exist_ok=True)
        (self.run.folder / "session.jsonl").write_text("{}\n")
        self.say({"type": "over"})

    def _state(self):
        self.say(
            {
                "type": "state",
                "mode": "teach",
                "paused": self.paused,
                "why": self.why,
                "speed": 1.0,
                "undos": 0,
            }
        )


class FakeHall:
    def __init__(self, places=64):
        self.places, self.seats, self.lock = places, [], threading.Lock()
        self.awaited = []

    def await_left(self, folder):
        self.awaited.append((folder, folder.exists(), [each.left for each in self.seats]))

    def seat(self, run, say):
        with self.lock:
            if len(self.seats) >= self.places:
                raise UserError("all places are taken")
            seat = FakeSeat(self, run, say)
            self.seats.append(seat)
        seat.everything()
        return seat
