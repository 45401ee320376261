"""What pages of a study may say, as `gpcjax.teach.protocol` has it for those of a lesson. Loads no jax.

A participant:

| `type`     | values                  | asks for                                                              |
|------------|-------------------------|-----------------------------------------------------------------------|
| `join`     | `code`, `take`          | to take part; with `take` also where another page of this code is open |
| `agree`    | `on`                    | to give consent, or not                                               |
| `measured` | as `MEASURED`           | what the check of screen and connection has measured                  |
| `go_on`    |                         | the next step, after something to read                                |
| `pause`    | `on`                    | to rest in a run, or to begin it and go on                            |
| `press`    | as a lesson's           | an advice                                                             |
| `hidden`   | `on`                    | nothing: the page cannot be seen, or can be again                     |
| `answers`  | `values`                | answers to the present questions, by their names                      |
| `leave`    |                         | to leave the study                                                    |
| `ping`     | `at`                    | an answer                                                             |

The experimenter: `pause` (with `on`), `stop` and `delete`, each with a participant's `code`, the first two also with an
empty one for all; and `ping`.
"""

from gpcjax.teach.protocol import FORMS, Forms, is_flag, is_number

LONGEST = 32 * 1024
"""Bytes of a message: a page of free texts fits."""

MEASURED = ("width", "height", "frame_rate", "round_trip")
"""Of the page in CSS pixels, animation frames a second, milliseconds to the server and back."""

_MOST_ANSWERS = 200


def _text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= 200


def _answers(value: object) -> bool:
    return (
        isinstance(value, dict)
        and len(value) <= _MOST_ANSWERS
        and all(each is None or isinstance(each, str | int) for each in value.values())
    )


def _positive(value: object) -> bool:
    return is_number(value) and isinstance(value, int | float) and value >= 0


PARTICIPANT: Forms = {
    "join": {"code": _text, "take": is_flag},
    "agree": {"on": is_flag},
    "measured": dict.fromkeys(MEASURED, _positive),
    "go_on": {},
    "pause": {"on": is_flag},
    "press": FORMS["press"],
    "hidden": {"on": is_flag},
    "answers": {"values": _answers},
    "leave": {},
    "ping": {"at": is_number},
}
EXPERIMENTER: Forms = {
    "pause": {"code": _text, "on": is_flag},
    "stop": {"code": _text},
    "delete": {"code": _text},
    "ping": {"at": is_number},
}
