"""Where a study is for a scripted participant, its page, and how it went. Standard library only."""

import re
import urllib.request
from dataclasses import dataclass
from urllib.parse import urlsplit

SECONDS = 20.0
"""For an answer of the server."""

REFERENCES = re.compile(r'(?:src|href)="(/[^"]*)"')


@dataclass(frozen=True)
class Place:
    """Where the study is."""

    address: str
    """http(s)://HOST[:PORT]/"""

    @property
    def origin(self) -> str:
        """As a browser tells it."""
        parts = urlsplit(self.address)
        return f"{parts.scheme}://{parts.netloc}"

    @property
    def socket(self) -> str:
        """Of a participant's page."""
        return f"{'wss' if self.address.startswith('https') else 'ws'}://{urlsplit(self.address).netloc}/part"


@dataclass
class Outcome:
    """How it went for one of them."""

    code: str
    kind: str
    ended: str = ""
    """The state that the server told, "gave up", "refused", or "lost"."""
    text: str = ""
    """Why, where it was refused or lost."""
    completion: str | None = None
    """The completion code, or the link."""
    presses: int = 0
    learned: int = 0
    """Of its advices those that the learner has learned from."""
    runs: int = 0
    connections: int = 0
    seconds: float = 0.0


def load_page(address: str, code: str) -> int:
    """Loads the page and what it refers to, as a browser does first; gives the number of files.

    Raises:
        OSError: a file is not there, or nobody answers.
    """
    parts = urlsplit(address)
    root = f"{parts.scheme}://{parts.netloc}"
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))

    def get(path: str) -> bytes:
        with opener.open(root + path, timeout=SECONDS) as answer:
            return answer.read()

    page = get(f"/?code={code}").decode()
    paths = dict.fromkeys(REFERENCES.findall(page))
    for path in paths:
        get(path)
    return 1 + len(paths)
