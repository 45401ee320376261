"""What a page may say: the table of forms, and nothing else."""

import json
import math

import hypothesis.strategies as st
import pytest
from hypothesis import example, given

from gpcjax.teach.protocol import MESSAGE_BYTES, Command, Press, Refused, parse

PRESS = {"type": "press", "id": 3, "dim": 0, "h": -1, "n": 7, "at": 12.5, "held": False}
FORMS = [
    PRESS,
    PRESS | {"drawn": 11.25},
    {"type": "take"},
    {"type": "pause", "on": True},
    {"type": "step"},
    {"type": "reset"},
    {"type": "undo"},
    {"type": "speed", "value": 0.5},
    {"type": "run", "on": False},
    {"type": "learner", "name": "gpc", "settings": {"eta": 0.1}},
    {"type": "save", "name": "first try-1.b"},
    {"type": "open", "name": "a"},
    {"type": "map", "x": 0, "y": 1, "dim": 0},
    {"type": "ping", "at": 0},
]

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=10,
)


def _refused(text):
    with pytest.raises(Refused):
        parse(text)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form["type"])
def test_each_form_is_read_with_its_values(form):
    command = parse(json.dumps(form))
    assert command.type == form["type"]
    if form["type"] != "press":
        assert command.values == {name: form[name] for name in form.keys() - {"type"}}


def test_a_press_without_the_time_of_its_frame_has_that_of_the_key():
    assert parse(json.dumps(PRESS)).press == Press(3, 0, -1, 7, 12.5, 12.5, False)
    assert parse(json.dumps(PRESS | {"drawn": 11.25})).press == Press(3, 0, -1, 7, 12.5, 11.25, False)


@given(st.text(max_size=200) | st.binary(max_size=200))
@example(b"\xff\xfe")
@example("[" * MESSAGE_BYTES)
@example('{"a":' * 800)
@example("9" * MESSAGE_BYTES)
def test_anything_is_a_command_or_refused(text):
    try:
        command = parse(text)
    except Refused:
        return
    assert isinstance(command, Command)


@given(st.sampled_from(FORMS), st.data())
def test_a_value_of_another_kind_is_refused_or_stays_within_bounds(form, data):
    name = data.draw(st.sampled_from(sorted(form)))
    try:
        command = parse(json.dumps(form | {name: data.draw(JSON)}))
    except Refused:
        return
    numbers = [*command.values.values(), *(command.press or ())]
    numbers += command.values.get("settings", {}).values()
    for number in numbers:
        assert not isinstance(number, int | float) or (math.isfinite(number) and abs(number) < 2**53)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form["type"])
def test_nothing_may_be_left_out_or_added(form):
    for name in form.keys() - {"drawn"}:
        _refused(json.dumps({each: form[each] for each in form if each != name}))
    _refused(json.dumps(form | {"more": 1}))


@pytest.mark.parametrize(
    "word", ["NaN", "Infinity", "-Infinity", "1e999", "1e16", "true", "null", '"1"', "[1]"]
)
def test_what_is_no_usual_number_is_none(word):
    _refused(f'{{"type":"ping","at":{word}}}')
    _refused(f'{{"type":"speed","value":{word}}}')
    _refused(f'{{"type":"learner","name":"gpc","settings":{{"eta":{word}}}}}')


@pytest.mark.parametrize("count", ["1.0", "-1", "1.5", "true", "9007199254740992", "1e3"])
def test_a_count_is_a_whole_number_from_zero_on(count):
    _refused(f'{{"type":"map","x":{count},"y":1,"dim":0}}')
    _refused(json.dumps(PRESS).replace('"n": 7', f'"n": {count}'))


@pytest.mark.parametrize("h", ["0", "2", "1.0", "true", "-1.0"])
def test_advice_is_less_or_more(h):
    _refused(json.dumps(PRESS).replace('"h": -1', f'"h": {h}'))


@pytest.mark.parametrize("value", [0.0999, 2.01, 0, -1])
def test_a_speed_has_bounds(value):
    _refused(json.dumps({"type": "speed", "value": value}))


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../a", "a/b", "a\\b", "/etc", "~", ".hidden", " a", "a ", "a.", "a\n", "a\0", "é", "a\u202eb",
     "-rf", "C:a", "a" * 41, "\ud800"],
)  # fmt: skip
def test_a_name_that_could_be_another_folder_is_refused(name):
    for kind in ("save", "open"):
        _refused(json.dumps({"type": kind, "name": name}))


def test_settings_are_few():
    for count, read in ((32, True), (33, False)):
        text = json.dumps({"type": "learner", "name": "a", "settings": {f"s{i}": 1 for i in range(count)}})
        if read:
            assert len(parse(text).values["settings"]) == count
        else:
            _refused(text)


def test_a_message_is_as_long_as_its_bytes():
    empty = json.dumps({"type": "ping", "at": 1})
    assert parse(empty.ljust(MESSAGE_BYTES)).type == "ping"
    _refused(empty.ljust(MESSAGE_BYTES + 1))
    _refused((empty.ljust(MESSAGE_BYTES + 1)).encode())
    named = {"type": "learner", "name": "é" * 150, "settings": {"é" * (20 + i): 1 for i in range(32)}}
    text = json.dumps(named, ensure_ascii=False).ljust(MESSAGE_BYTES)
    assert len(text) == MESSAGE_BYTES < len(text.encode())
    _refused(text)
