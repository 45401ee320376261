"""Many people at once, as each would feel it: `python -m benchmarks.classroom`, part of `make bench-teach`.

For each number of teachers: one process with a hall (`gpcjax.study.hall`) behind a websocket for each, and one with as
many scripted teachers, who press eight times a second for two seconds of every six. With more and more of them, until
it ends: where steps or answers are late.

| figure    | what                                                                                      |
|-----------|-------------------------------------------------------------------------------------------|
| `tick_ms` | how far a step began from its time, in the hall                                           |
| `jitter_ms` | how far apart the frames of one teacher came, from the step's time, at the other end    |
| `press_ms` | from the key to the first frame whose action knows of it, at the other end               |

One line of JSON for each number, with the cores' time that a second took, for `benchmarks/README.md`.
"""

import argparse
import asyncio
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

TICK, PRESS = 5.0, 60.0
"""Milliseconds that the 95th percentiles of `tick_ms` and `press_ms` may have."""

BURST, ROUND, APART = 2.0, 6.0, 1 / 8
"""Seconds: somebody presses for so long, out of so many, so far apart."""

TEACHERS, SECONDS = "1,8,64,128,256", 20.0
"""Numbers of teachers, and for how long each is measured."""

WARM = 2.0
"""Seconds before what is measured."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--teachers", default=TEACHERS, help="how many, number by number")
    parser.add_argument("--kinds", default="cartpole/gpc", help="TASK/LEARNER, one or several")
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--serve", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--teach", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve is not None:
        serve(arguments.serve, arguments.kinds.split(","))
    elif arguments.teach is not None:
        port, count = map(int, arguments.teach.split(","))
        print(json.dumps(asyncio.run(teach(port, count, arguments.seconds))))
    else:
        run(arguments.teachers, arguments.kinds, arguments.seconds)


def run(teachers: str, kinds: str, seconds: float) -> None:
    """A line of figures for each number of teachers, up to the first that is too many."""
    for count in map(int, filter(None, teachers.split(","))):
        figures = measure(count, kinds, seconds)
        print(json.dumps(figures), flush=True)
        if figures["tick_ms"]["p95"] > TICK or figures["press_ms"]["p95"] > PRESS:
            print(f"{count} are too many: it ends there", file=sys.stderr)
            break


def measure(count: int, kinds: str, seconds: float) -> dict[str, Any]:
    """The figures for so many teachers."""
    module = [sys.executable, "-m", "benchmarks.classroom", "--kinds", kinds, "--seconds", str(seconds)]
    server = subprocess.Popen([*module, "--serve", str(count)], stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        port = server.stdout.readline().strip()
        told = subprocess.run(
            [*module, "--teach", f"{port},{count}"], stdout=subprocess.PIPE, text=True, check=True
        )
        before = _load()
    finally:
        server.terminate()
        server.wait()
    return {"teachers": count, "kinds": kinds, "load": before, **json.loads(told.stdout)}


def _load() -> float:
    """Of the machine, in the last minute: more than its cores, and the figures are of others too."""
    return round(os.getloadavg()[0], 1)


# --- the hall


def serve(places: int, kinds: list[str]) -> None:
    """A hall with so many places, until somebody ends it; its port is the first line that it prints."""
    from gpcjax.sweep.environment import compute_here
    from gpcjax.teach.run import SWITCH_SECONDS

    compute_here()
    sys.setswitchinterval(SWITCH_SECONDS)
    import uvicorn
    from starlette.applications import Starlette
    from starlette.routing import WebSocketRoute
    from starlette.websockets import WebSocket

    from gpcjax.study.hall import Hall, Run
    from gpcjax.sweep.given import Given
    from gpcjax.teach.course import Course
    from gpcjax.teach.protocol import parse

    def course(number: int) -> Course:
        env, algo = kinds[number % len(kinds)].split("/")
        return Course.of({"env": Given(env, "env"), "algo": Given((algo,), "algo")}, number)

    hall = Hall(
        [course(number) for number in range(len(kinds))], places, lambda text: print(text, file=sys.stderr)
    )
    hall.start()

    async def lesson(websocket: WebSocket) -> None:
        await websocket.accept()
        number = int(websocket.path_params["number"])
        mail = Mail(asyncio.get_running_loop())
        seat = hall.seat(Run(folder / str(number), course(number), 10**6), mail.put)
        sending = asyncio.create_task(mail.send(websocket))
        try:
            while True:
                command = parse(await websocket.receive_text())
                if command.press is not None:
                    seat.press(command.press)
                elif command.type == "pause":
                    seat.go_on()
        except Exception:
            sending.cancel()
            seat.leave()

    signal.signal(signal.SIGTERM, lambda *_: None)  # what ends the server, which sends it on
    with tempfile.TemporaryDirectory() as scratch, socket.socket() as listening:
        folder = Path(scratch)
        listening.bind(("127.0.0.1", 0))
        listening.listen(1024)
        print(listening.getsockname()[1], flush=True)
        config = uvicorn.Config(
            Starlette(routes=[WebSocketRoute("/{number:int}", lesson)]),
            log_level="warning",
            access_log=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        uvicorn.Server(config).run(sockets=[listening])
        hall.close()


class Mail:
    """Messages from the hall's threads to one page: the server is woken once for all that came meanwhile."""

    def __init__(self, loop: asyncio.AbstractEventLoop):
        self._loop, self._waiting, self._lock = loop, deque(), threading.Lock()
        self._something, self._woken = asyncio.Event(), False

    def put(self, message: dict[str, Any]) -> None:
        with self._lock:
            self._waiting.append(message)
            if self._woken:
                return
            self._woken = True
        self._loop.call_soon_threadsafe(self._something.set)

    async def send(self, websocket: Any) -> None:
        while True:
            await self._something.wait()
            self._something.clear()
            with self._lock:
                messages, self._woken = [*self._waiting], False
                self._waiting.clear()
            for message in messages:
                await websocket.send_text(json.dumps(message, separators=(",", ":")))


# --- the teachers


async def teach(port: int, count: int, seconds: float) -> dict[str, Any]:
    """So many teachers at once, and what they saw."""
    teachers = [Teacher(port, number) for number in range(count)]
    await asyncio.gather(*(teacher.come() for teacher in teachers))
    ends = time.monotonic() + WARM + seconds
    await asyncio.gather(*(teacher.teach(ends) for teacher in teachers))
    gaps = np.concatenate([teacher.gaps() for teacher in teachers])
    late = np.concatenate([np.array(teacher.late) for teacher in teachers])
    presses = np.concatenate([np.array(teacher.presses) for teacher in teachers]) * 1000
    return {
        "frames_a_second": round(len(gaps) / seconds / count, 2),
        "tick_ms": spread(late),
        "jitter_ms": spread(np.abs(gaps)),
        "press_ms": spread(presses),
        "corrections": sum(teacher.corrections for teacher in teachers),
    }


def spread(values: np.ndarray) -> dict[str, float]:
    """How many, and the usual percentiles."""
    points = {f"p{point}": round(float(np.percentile(values, point)), 2) for point in (50, 95, 99)}
    return {"n": len(values), **points, "max": round(float(values.max()), 2)}


class Teacher:
    """One scripted teacher."""

    def __init__(self, port: int, number: int):
        self._port, self._number = port, number
        self._draw = random.Random(number)
        self._frames: list[tuple[int, float]] = []
        self._pressed: dict[int, float] = {}
        self._answered: list[float] = []
        self._step = 0.02
        self.late: list[float] = []
        self.presses: list[float] = []
        self.corrections = 0

    async def come(self) -> None:
        """Connects, and waits until all is ready."""
        from websockets.asyncio.client import connect

        address = f"ws://127.0.0.1:{self._port}/{self._number}"
        self._socket = await connect(address, compression=None, max_queue=None)
        while (message := json.loads(await self._socket.recv()))["type"] != "frame":
            if message["type"] == "task":
                self._step = message["task"]["step"]

    async def teach(self, ends: float) -> None:
        """Runs, presses and looks, until then."""
        await self._socket.send('{"type":"pause","on":false}')
        await asyncio.gather(self._look(ends), self._press(ends))
        await self._socket.close()

    def gaps(self) -> np.ndarray:
        """Milliseconds by which frames came nearer or further than a step, but for those of a new episode."""
        times = np.array([at for _, at in self._frames])
        return (np.diff(times) - self._step) * 1000

    async def _look(self, ends: float) -> None:
        begins = time.monotonic() + WARM
        while (now := time.monotonic()) < ends:
            message = json.loads(await self._socket.recv())
            now = time.monotonic()
            if message["type"] == "frame" and now > begins:
                self._frames.append((message["n"], now))
                self.late.append(message["late"])
                self.presses += [now - pressed for pressed in self._answered]
                self._answered.clear()
            elif message["type"] == "advised":
                self.corrections = message["corrections"]
                pressed = self._pressed.pop(message["id"])
                if now > begins:
                    self._answered.append(pressed)
            elif message["type"] == "problem":
                raise RuntimeError(message["text"])

    async def _press(self, ends: float) -> None:
        number = 0
        await asyncio.sleep(self._draw.uniform(0, ROUND))
        while time.monotonic() < ends:
            for _ in range(round(BURST / APART)):
                number += 1
                self._pressed[number] = time.monotonic()
                press = {
                    "id": number,
                    "dim": 0,
                    "h": self._draw.choice((-1, 1)),
                    "n": 0,
                    "at": 0,
                    "held": False,
                }
                await self._socket.send(json.dumps({"type": "press", **press}))
                await asyncio.sleep(APART)
            await asyncio.sleep(ROUND - BURST)


if __name__ == "__main__":
    main()
