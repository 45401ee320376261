import errno
import os
import re
import resource

import pytest

from gpcjax.sweep.atomic import atomic_path, clean, target_of, write_atomic


def test_writes_text_and_bytes(tmp_path):
    write_atomic(tmp_path / "a", "ä\n")
    write_atomic(tmp_path / "b", b"\x00\r\n")
    assert (tmp_path / "a").read_bytes() == b"\xc3\xa4\n"
    assert (tmp_path / "b").read_bytes() == b"\x00\r\n"
    assert sorted(os.listdir(tmp_path)) == ["a", "b"]


def test_old_content_stays_until_the_new_is_whole(tmp_path):
    path = tmp_path / "rows.parquet"
    write_atomic(path, "old")
    with atomic_path(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert temporary.parent == tmp_path
        assert list(tmp_path.glob("*.parquet")) == [path]
    assert path.read_text() == "new"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failure_leaves_nothing_behind(tmp_path, error):
    path = tmp_path / "file"
    write_atomic(path, "old")
    with pytest.raises(error), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise error
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file"]


def test_two_writers_do_not_meet(tmp_path):
    with atomic_path(tmp_path / "file") as one, atomic_path(tmp_path / "file") as other:
        assert one != other
        one.write_text("one")
        other.write_text("other")
    assert (tmp_path / "file").read_text() == "one"
    assert os.listdir(tmp_path) == ["file"]


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_atomic(tmp_path / "none" / "file", "text")


def test_an_error_names_the_file(tmp_path):
    """Not the temporary one; and where nothing more fits, where Python names none."""
    path = tmp_path / "file"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        with pytest.raises(OSError, match=re.escape(f"'{path}'")) as caught:
            write_atomic(path, "longer than that")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.errno == errno.EFBIG and str(caught.value).endswith(f": '{path}'")
    path = tmp_path / "none" / "file"
    with pytest.raises(FileNotFoundError, match=re.escape(f"'{path}'")) as caught:
        write_atomic(path, "text")
    assert str(caught.value) == f"[Errno {errno.ENOENT}] No such file or directory: '{path}'"


def test_permissions_follow_the_umask(tmp_path):
    write_atomic(tmp_path / "file", "text")
    (tmp_path / "other").write_text("text")
    assert (tmp_path / "file").stat().st_mode == (tmp_path / "other").stat().st_mode


DEAD = 4_999_999
"""More than Linux counts to: no process has it."""


def temporary(target, pid=DEAD):
    return f".gpcjax-{pid}-0123456789ab.{target}.tmp"


class TestClean:
    def test_ours_go_at_once_others_when_they_are_old(self, tmp_path):
        for target in "abc":
            (tmp_path / temporary(target)).touch()
        (tmp_path / temporary("a", os.getpid())).touch()
        os.utime(tmp_path / temporary("c"), (0, 0))
        clean(tmp_path, lambda target: target == "a")
        assert os.listdir(tmp_path) == [temporary("b")]

    @pytest.mark.parametrize(
        "name",
        [
            *("a", ".a.tmp", ".a.0123456789ab.tmp", ".manifest.json.0123456789ab.tmp", "a.0123456789ab.tmp"),
            *(temporary("a")[1:], temporary("a") + "~", temporary("a").replace("ab.", "AB."), temporary("")),
            *(temporary("a").replace("gpcjax", "gpc"), temporary("a", "x"), temporary("a", -1)),
        ],
    )
    def test_what_is_not_of_our_form_stays(self, tmp_path, name):
        """Another program's file of the same kind of name is another program's."""
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (0, 0))
        clean(tmp_path, lambda target: True)
        assert os.listdir(tmp_path) == [name] and target_of(name) is None

    def test_what_a_process_writes_that_still_runs_stays(self, tmp_path):
        """Where a file system has no locks there may be a second writer."""
        for pid in (os.getppid(), 1):
            (tmp_path / temporary("a", pid)).touch()
            os.utime(tmp_path / temporary("a", pid), (0, 0))
        clean(tmp_path, lambda target: True)
        assert len(os.listdir(tmp_path)) == 2
        (tmp_path / temporary("a", 9_999_999_999)).touch()
        clean(tmp_path, lambda target: True)
        assert len(os.listdir(tmp_path)) == 2

    def test_what_cannot_be_removed_is_no_error(self, tmp_path):
        (tmp_path / temporary("a")).mkdir()
        clean(tmp_path, lambda target: True)
        clean(tmp_path / "none", lambda target: True)
        assert (tmp_path / temporary("a")).is_dir()

    def test_it_knows_its_own(self, tmp_path):
        with atomic_path(tmp_path / "a.b") as path:
            path.touch()
            assert target_of(path.name) == "a.b"
