import re

import pytest

from gpcjax.sweep import machine
from gpcjax.sweep.environment import xla_options

EPYC = "processor\t: 0\nmodel name\t: AMD EPYC\ncpu family\t: 25\nmodel\t\t: {model}\nstepping\t: 1\n"
EPYC += "flags\t\t: fpu {flags} sha_ni\n"


@pytest.fixture
def described(monkeypatch, tmp_path):
    """The description of a machine with another /proc/cpuinfo, or other flags of XLA."""

    def describe(model="1", flags="sse4_2 avx2 fma", xla="", cpuinfo=EPYC):
        text = cpuinfo.format(model=model, flags=flags)
        (tmp_path / "cpuinfo").write_text(text + "\n" + text.replace("EPYC", "another core"))
        with monkeypatch.context() as patch:
            patch.setattr(machine, "CPUINFO", tmp_path / "cpuinfo")
            patch.setenv("XLA_FLAGS", xla)
            return machine.describe()

    return describe


def test_what_bits_depend_on(described):
    got = described()
    assert got["processor"] == "AMD EPYC" and got["cpu_family"] == "25" and got["cpu_model"] == "1 1"
    assert got["vector_features"] == "avx2 fma sse4_2"
    assert got["vector_width"] == 512 and all(option in got["xla_flags"] for option in xla_options())
    assert re.match(r"scipy \d", got["lapack"])
    assert got["cores"] >= 1 and got["architecture"] and got["platform"]


def test_processors_of_one_name_are_told_apart(described):
    """Of two called AMD EPYC one has AVX-512, and rows of GPC-NS differ."""
    one, other = described(), described(flags="sse4_2 avx2 fma avx512f avx512_bf16")
    assert one["processor"] == other["processor"]
    assert machine.kind_of(one) != machine.kind_of(other)
    assert machine.differences(one, other) == ["vector_features"]
    assert machine.kind_of(one) != machine.kind_of(described(model="17"))
    assert (
        machine.kind_of(one)
        == machine.kind_of(described())
        == machine.kind_of(one | {"cores": 999, "platform": "x"})
    )


def test_a_users_own_options_of_xla_are_not_in_force(described):
    """Workers do not get them: rows are those of the same machine without."""
    got = described(xla="--xla_cpu_prefer_vector_width=256")
    assert got["vector_width"] == 512 and machine.kind_of(got) == machine.kind_of(described())


def test_an_arm_processor(described):
    text = "processor\t: 0\nFeatures\t: fp asimd sha1 sve\nCPU implementer\t: 0x41\nCPU part\t: 0xd0c\n"
    got = described(cpuinfo=text)
    assert (
        got["vector_features"] == "asimd sve" and got["cpu_family"] == "0x41" and got["cpu_model"] == "0xd0c"
    )


def test_a_machine_that_tells_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(machine, "CPUINFO", tmp_path / "none")
    got = machine.describe()
    assert got["vector_features"] == "" and machine.kind_of(got)


def test_an_old_manifest_does_not_say():
    assert machine.kind_of({"platform": "Linux", "processor": "AMD EPYC", "cores": 2}) == ""
