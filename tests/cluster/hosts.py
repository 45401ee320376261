"""Two hosts of a Ray cluster on this machine: in network namespaces of their own where it allows them, or on loopback.

A host is a raylet with some cores; the first one has the head of the cluster and is where drivers run. Whatever was
started on a host ends with it.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.sweep.processes import alive, workers_of

PORT = 6399
_RAY = "from ray.scripts.scripts import main; main()"
_ROOT = Path(__file__).parents[2]


def can_have_namespaces() -> bool:
    """Whether this process may make network namespaces, found out by one."""
    if os.geteuid() or shutil.which("ip") is None:
        return False
    name = f"gpcjax-{os.getpid()}-try"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True).returncode == 0
    subprocess.run(["ip", "netns", "delete", name], capture_output=True)
    return made


class Host:
    """One host: runs commands, can be frozen and killed."""

    def __init__(self, address: str, namespace: str, environment: dict[str, str]):
        self.address, self._namespace, self._environment = address, namespace, environment
        self._started: list[subprocess.Popen[bytes]] = []

    def start(self, words: Sequence[str], **options) -> subprocess.Popen[bytes]:
        """A process there."""
        inside = ["ip", "netns", "exec", self._namespace] if self._namespace else []
        process = subprocess.Popen(
            [*inside, *words], env=self._environment, start_new_session=True, **options
        )
        self._started.append(process)
        return process

    def python(self, *words: str, **options) -> subprocess.Popen[bytes]:
        """Python there, with this checkout."""
        return self.start([sys.executable, *words], cwd=_ROOT, **options)

    def kill(self) -> None:
        """Ends all that runs there, at once, as if it had lost its power."""
        for pid in self.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for process in self._started:
            process.wait()

    def processes(self) -> list[int]:
        """All processes there: of the namespace, or below those that were started."""
        if self._namespace:
            listed = subprocess.run(["ip", "netns", "pids", self._namespace], capture_output=True, text=True)
            return [int(pid) for pid in listed.stdout.split()]
        roots = [process.pid for process in self._started if process.poll() is None]
        return [*roots, *(pid for root in roots for pid in descendants(root))]

    def workers(self) -> list[int]:
        """Processes there that compute."""
        return [pid for pid in self.processes() if b"executors/served.py" in command_of(pid) and alive(pid)]


def descendants(pid: int) -> list[int]:
    """Processes that this one has started, and those of these."""
    found, left = [], workers_of(pid)
    while left:
        found.append(left.pop())
        left += workers_of(found[-1])
    return found


def command_of(pid: int) -> bytes:
    """Its words; nothing if it is gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


@contextlib.contextmanager
def hosts(cores: Sequence[int] = (1, 1), namespaces: bool | None = None) -> Iterator[list[Host]]:
    """Hosts with so many cores each, in one Ray cluster."""
    namespaces = can_have_namespaces() if namespaces is None else namespaces
    own = f"gpcjax-{os.getpid()}"
    with tempfile.TemporaryDirectory(prefix="gpcjax-ray-") as folder, contextlib.ExitStack() as opened:
        if namespaces:
            opened.enter_context(_bridge(own, len(cores)))
        made = []
        for number, count in enumerate(cores, 1):
            address = f"10.213.7.{number}" if namespaces else "127.0.0.1"
            home = Path(folder, f"home-{number}")
            home.mkdir()
            environment = {
                **{name: os.environ[name] for name in ("PATH", "LANG", "TMPDIR") if name in os.environ},
                "HOME": str(home),
                "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str(Path("~/.cache").expanduser())),
                "PYTHONPATH": str(_ROOT),
                "RAY_USAGE_STATS_ENABLED": "0",
                "RAY_health_check_initial_delay_ms": "1000",
                "RAY_health_check_period_ms": "500",
                "RAY_health_check_timeout_ms": "1000",
                "RAY_health_check_failure_threshold": "4",
            }
            host = Host(address, f"{own}-{number}" if namespaces else "", environment)
            opened.callback(host.kill)
            made.append(host)
            _start_ray(host, made[0], count, folder)
        yield made


def _start_ray(host: Host, head: Host, cores: int, folder: str) -> None:
    first = host is head
    where = (
        ["--head", f"--port={PORT}", f"--temp-dir={folder}/ray", "--include-dashboard=false"]
        if first
        else [f"--address={head.address}:{PORT}"]
    )
    log = open(Path(folder, f"log-{host.address}-{first}"), "wb")  # noqa: SIM115
    words = ["-c", _RAY, "start", *where, f"--node-ip-address={host.address}", f"--num-cpus={cores}"]
    words += ["--object-store-memory=100000000", "--disable-usage-stats", "--block"]
    process = host.python(*words, stdout=log, stderr=log)
    until = time.monotonic() + 60.0
    while b"Ray runtime started" not in Path(log.name).read_bytes():
        assert process.poll() is None and time.monotonic() < until, Path(log.name).read_text()
        time.sleep(0.1)
    log.close()


@contextlib.contextmanager
def _bridge(own: str, count: int) -> Iterator[None]:
    """Namespaces `OWN-1` and so on, each with an address of its own on one bridge, and none that leads out."""
    bridge = f"gj{os.getpid() % 100_000}"

    def ip(*words: str, check: bool = True) -> None:
        subprocess.run(["ip", *words], check=check, capture_output=True)

    try:
        ip("netns", "add", own)  # the bridge has one of its own, too: nothing of the machine is touched
        ip("-n", own, "link", "add", bridge, "type", "bridge")
        ip("-n", own, "link", "set", bridge, "up")
        for number in range(1, count + 1):
            name = f"{own}-{number}"
            ip("netns", "add", name)
            ip("-n", own, "link", "add", f"v{number}", "type", "veth", "peer", "name", "eth0", "netns", name)
            ip("-n", own, "link", "set", f"v{number}", "master", bridge, "up")
            ip("-n", name, "address", "add", f"10.213.7.{number}/24", "dev", "eth0")
            ip("-n", name, "link", "set", "eth0", "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield
    finally:
        for name in (own, *(f"{own}-{number}" for number in range(1, count + 1))):
            ip("netns", "delete", name, check=False)
