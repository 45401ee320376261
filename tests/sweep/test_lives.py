"""Whatever becomes of a run folder, what whole files hold is read, once and with its settings."""

import random

import pytest

from tests.sweep.lives import Life


def seeds(*quick):
    return [seed if seed in quick else pytest.param(seed, marks=pytest.mark.slow) for seed in range(40)]


@pytest.mark.parametrize("seed", seeds(0))
def test_a_life(tmp_path, monkeypatch, seed):
    life = Life(tmp_path / "out", random.Random(seed), monkeypatch)
    try:
        for _ in range(8):
            life.step()
    except BaseException:
        print(*life.told, sep="\n")
        raise


@pytest.mark.parametrize("seed", seeds(5))
def test_a_life_in_shards(tmp_path, monkeypatch, seed):
    life = Life(tmp_path / "out", random.Random(seed), monkeypatch)
    try:
        life.in_shards()
        if seed % 2:
            life.in_shards()
        for _ in range(3):
            life.step()
    except BaseException:
        print(*life.told, sep="\n")
        raise
