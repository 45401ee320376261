"""A specification as a file: it comes back the same, to the bit."""

import pytest

from gpcjax.policies.saved import shipped_path
from gpcjax.sweep.spec import make_spec, read_toml, spec_of
from gpcjax.tune.toml import text_of

POINTS = [{"policy_length_scale": 0.1}, {"policy_length_scale": 2e-9}]
SETTINGS = [
    {"env": "cartpole", "algo": "gpc", "policy_length_scale": [0.1, 1 / 3], "noise": 1e-7},
    {"env": "pendulum", "error": [0, 0.1], "seeds": "100-199", "points": POINTS},
    {"env": "cartpole", "algo": "gpc-ns", "rate_schedule": [0.1], "sparsify": False, "max_capacity": 64},
    {"env": "cartpole", "algo": "gpc-ns", "on_full": "drop"},
    {"env": "pendulum", "algo": "coach", "beta": 3.0},
    {"env": "pendulum", "algo": "d-coach"},
    {
        "env": "mountaincar",
        "algo": ["gpc", "coach"],
        "delta": [0.0, 0.1],
        "rate": 0.3,
        "seeds": "3,7",
        "beta": 1e300,
    },
    {"env": "cartpole", "algo": "gpc", "oracle": 'so"\\strange'},
    {"env": "cartpole", "algo": "gpc", "credit": 0.2, "delay": [0.1, 0.2]},
]


@pytest.mark.parametrize("number", range(len(SETTINGS)))
def test_it_comes_back(tmp_path, monkeypatch, number):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'so"\\strange').symlink_to(shipped_path("cartpole"))
    spec = spec_of(**SETTINGS[number])
    path = tmp_path / "a.toml"
    path.write_text(text_of(spec, ["what it is", "", "and why"]))
    assert make_spec(read_toml(path)) == spec
    assert path.read_text().startswith("# what it is\n#\n# and why\n\nenv = ")
