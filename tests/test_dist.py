"""Wheel and source distribution hold what they should; `make dist` installs and tries them (`tests/dist.py`)."""

import tarfile
import zipfile

import pytest

from tests import dist


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The source distribution and the wheel."""
    place = tmp_path_factory.mktemp("dist")
    return tuple(place / dist._built(dist.ROOT, kind, place) for kind in ("build_sdist", "build_wheel"))


def test_both_are_as_they_should_be(built):
    source, wheel = built
    dist.check_wheel(wheel)
    dist.check_source(source, wheel)
    names = zipfile.ZipFile(wheel).namelist()
    for name in ("py.typed", "teach/page/index.html", "policies/shipped/cartpole/card.json", "__main__.py"):
        assert f"gpcjax/{name}" in names
    assert not [name for name in names if name.startswith(("tests", "docs"))]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gpcjax/teach/page/index.html": None}, "lacks gpcjax/teach/page/index.html"),
        ({"gpcjax/notes.txt": b"mine"}, "holds gpcjax/notes.txt"),
        ({"tests/__init__.py": b""}, "holds tests/__init__.py"),
        ({"METADATA": b"Provides-Extra: teach\n"}, "names the extras teach, not teach, cluster"),
    ],
    ids=str,
)
def test_a_wheel_that_is_wrong_is_told(built, change, message, tmp_path):
    content = dist._content(built[1])
    card = next(name for name in content if name.endswith("/METADATA"))
    content |= {card if name == "METADATA" else name: text for name, text in change.items()}
    wrong = tmp_path / built[1].name
    with zipfile.ZipFile(wrong, "w") as archive:
        for name, text in content.items():
            if text is not None:
                archive.writestr(name, text)
    with pytest.raises(dist.Wrong, match=message):
        dist.check_wheel(wrong)


def test_a_source_that_lacks_a_file_is_told(built, tmp_path):
    source, wheel = built
    short = tmp_path / source.name
    with tarfile.open(source) as old, tarfile.open(short, "w:gz", compresslevel=1) as new:
        for member in old:
            if not member.name.endswith("/page/index.html"):
                new.addfile(member, old.extractfile(member) if member.isfile() else None)
    with pytest.raises(dist.Wrong, match=r"differs in .*gpcjax/teach/page/index.html"):
        dist.check_source(short, wheel)
