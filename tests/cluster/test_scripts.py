"""The scripts below sweeps/cluster, with a `gpcjax` and a `ray` that say how they were called."""

import os
import shlex
import subprocess
from pathlib import Path

import pytest

from gpcjax.cli.words import parse_words, settings
from gpcjax.errors import UserError
from gpcjax.sweep.shards import shard_of

SCRIPTS = Path(__file__).parents[2] / "sweeps" / "cluster"


@pytest.fixture
def called(tmp_path):
    """Runs words of a shell with these variables; gives the words that `gpcjax` or `ray` got, or stderr."""
    for name in ("gpcjax", "ray"):
        (tmp_path / name).write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
        (tmp_path / name).chmod(0o755)

    def call(words, **variables):
        environment = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", **variables}
        done = subprocess.run(words, env=environment, cwd=tmp_path, capture_output=True, text=True)
        return done.stdout.splitlines() if done.returncode == 0 else done.stderr

    return call


def given(words):
    """The settings of a sweep's words, as the command reads them."""
    return {name: setting.value for name, setting in settings(parse_words(words)).items()}


class TestSlurm:
    def test_each_task_has_its_share(self, called):
        variables = {"SLURM_ARRAY_TASK_COUNT": "3", "SLURM_CPUS_PER_TASK": "4"}
        for task in (1, 2, 3):
            flags = ["--env", "cartpole", "--out", "a folder"]
            words = called([SCRIPTS / "slurm.sh", *flags], SLURM_ARRAY_TASK_ID=str(task), **variables)
            assert given(words) == {"env": "cartpole", "out": "a folder", "shard": f"{task}/3", "jobs": 4}
            assert shard_of(given(words)["shard"], "").number == task

    def test_one_task_again(self, called):
        words = called(
            [SCRIPTS / "slurm.sh"], SLURM_ARRAY_TASK_ID="2", SLURM_ARRAY_TASK_COUNT="1", SHARDS="8"
        )
        assert given(words) == {"shard": "2/8", "jobs": 1}

    def test_it_is_told_before_its_time_is_over(self):
        """Without B: SLURM tells the steps of srun, of which there are none."""
        lines = (SCRIPTS / "slurm.sh").read_text().splitlines()
        assert "#SBATCH --signal=B:TERM@60" in lines and any(line.startswith("exec ") for line in lines)

    def test_an_array_that_begins_at_zero_is_refused(self, called):
        variables = {"SLURM_ARRAY_TASK_ID": "0", "SLURM_ARRAY_TASK_COUNT": "3"}
        words = given(called([SCRIPTS / "slurm.sh", "--env", "cartpole"], **variables))
        with pytest.raises(UserError, match=r"^--shard '0/3': give i/n"):
            shard_of(words["shard"], "--shard")

    def test_outside_of_an_array(self, called):
        assert "sbatch --array=1-8" in called([SCRIPTS / "slurm.sh"])


class TestKubernetes:
    def job(self):
        """The lines of the file as `key: value`, and the command of its container."""
        lines = (SCRIPTS / "kubernetes.yaml").read_text().splitlines()
        pairs = dict(line.strip().removeprefix("- ").partition(": ")[::2] for line in lines if ": " in line)
        begin = next(number for number, line in enumerate(lines) if line.strip() == "- >-")
        depth = len(lines[begin + 1]) - len(lines[begin + 1].lstrip())
        text = [line.strip() for line in lines[begin + 1 :] if len(line) - len(line.lstrip()) == depth]
        return pairs, " ".join(text[: next(n for n, line in enumerate(text) if "JOB_COMPLETION" in line) + 1])

    def test_each_pod_has_its_share(self, called):
        pairs, command = self.job()
        of = int(pairs["completions"])
        assert pairs["completionMode"] == "Indexed" and pairs["value"].strip('"') in ("4", str(of))
        assert '              value: "8"' in (SCRIPTS / "kubernetes.yaml").read_text()
        for index in range(of):
            given_there = {"JOB_COMPLETION_INDEX": str(index), "SHARDS": str(of), "JOBS": "4"}
            got = given(called(["/bin/sh", "-c", command], **given_there))
            assert (
                got["shard"] == f"{index + 1}/{of}" and got["jobs"] == 4 and got["error"] == (0.0, 0.1, 0.2)
            )
            assert got["out"].startswith("/runs/")


class TestRay:
    def test_the_first_machine(self, called):
        words = called([SCRIPTS / "ray.sh"], CORES="3")
        assert words == shlex.split(
            "start --head --port=6379 --include-dashboard=false --disable-usage-stats --block --num-cpus=3"
        )

    def test_another_one(self, called):
        words = called([SCRIPTS / "ray.sh", "10.0.0.1:6379"], ADDRESS="10.0.0.2")
        assert words == shlex.split(
            "start --address=10.0.0.1:6379 --disable-usage-stats --block --node-ip-address=10.0.0.2"
        )
