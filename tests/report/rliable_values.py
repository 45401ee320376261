"""What rliable says of some runs, kept in rliable.json for `tests.report.test_compare_numbers`.

rliable needs arch, and that a pandas older than ours: in an environment of its own, this makes the file again.

    python3 -m venv /tmp/rliable && /tmp/rliable/bin/pip install rliable==1.2.0 'pandas<3'
    /tmp/rliable/bin/python tests/report/rliable_values.py > tests/report/rliable.json
"""

import json

import numpy as np
from rliable.library import create_performance_profile, get_interval_estimates
from rliable.metrics import probability_of_improvement

RESAMPLES = 5000


def samples() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Returns of two learners: smooth, with ties, of two kinds, quite apart, and equal."""
    random = np.random.default_rng(13)
    smooth = random.normal(0.7, 1.0, 24), random.normal(0.0, 1.2, 24)
    two_kinds = np.where(
        random.uniform(size=(2, 20)) < [[0.7], [0.4]], 2500.0, random.normal(60, 20, (2, 20))
    )
    return {
        "smooth": smooth,
        "ties": (np.round(smooth[0]), np.round(smooth[1])),
        "two kinds": (two_kinds[0], two_kinds[1]),
        "apart": (smooth[0] + 10, smooth[1]),
        "equal": (smooth[0], smooth[0]),
    }


def described(first: np.ndarray, second: np.ndarray) -> dict[str, object]:
    """Chance of improvement and profile of one task, with rliable's percentile intervals."""
    columns = first[:, None], second[:, None]
    _, bounds = get_interval_estimates({"a,b": columns}, probability_of_improvement, reps=RESAMPLES,
                                       random_state=np.random.RandomState(0))  # fmt: skip
    values = np.linspace(first.min() - 1, first.max() + 1, 9)
    above, band = create_performance_profile({"a": columns[0]}, values, reps=RESAMPLES)
    return {
        "first": first.tolist(),
        "second": second.tolist(),
        "better": float(probability_of_improvement(*columns)),
        "better_bounds": bounds["a,b"].ravel().tolist(),
        "values": values.tolist(),
        "above": above["a"].tolist(),
        "above_bounds": band["a"].tolist(),
    }


if __name__ == "__main__":
    print(json.dumps({name: described(*pair) for name, pair in samples().items()}, indent=1))
