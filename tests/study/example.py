"""A small study, as text and on disk, for tests."""

from gpcjax.study.register import open_folder

TOML = """
title = "Small"
seed = 7000
participants = 4
tasks = ["pendulum", "cartpole"]

[[learners]]
algo = "gpc"

[[learners]]
algo = "coach"

[orders]
tasks = "fixed"

[runs]
dummy = 1
recorded = 1
episodes = 2
rest = 0

[consent]
text = "You may leave at any time."

[check]
width = 300
round_trip = 500

[instructions]
text = "Press a key."

[trial]
task = "cartpole"
presses = 1
attempts = 2

[[questions]]
name = "easy"
when = "learner"
kind = "scale"
text = "How easy was it?"
labels = ["hard", "easy"]

[[questions]]
name = "remarks"
kind = "text"
text = "Anything else?"

[completed]
text = "Done."
code = "C0FFEE"
link = "https://example.org/back?who={code}"
"""


def written(changes, text=TOML):
    """The text with each of these replaced, once."""
    for old, new in changes.items():
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def study_with(folder, old="", new="", text=TOML):
    """The folder of a study, and the study, with one text replaced in its file."""
    spec = folder / "study_small.toml"
    spec.write_text(written({old: new} if old else {}, text))
    out = folder / "out"
    return out, open_folder(out, spec)
