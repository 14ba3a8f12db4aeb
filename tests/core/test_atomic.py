import pytest

from autolights.core.atomic import new_file, new_folder, sha256, write_text
from autolights.core.errors import UsageError


class StopNow(BaseException):
    """Stands for Ctrl-C: no Exception."""


def interrupted_file(path):
    with new_file(path) as temporary:
        temporary.write_text("half")
        raise StopNow


def interrupted_folder(path, *, force=False):
    with new_folder(path, force=force) as folder:
        (folder / "half.txt").write_text("half")
        raise StopNow


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_file_appears_whole_with_its_folders(tmp_path):
    target = tmp_path / "a" / "b" / "file.txt"

    with new_file(target) as temporary:
        temporary.write_text("half")
        assert not target.exists()
        temporary.write_text("whole")

    assert target.read_text() == "whole"
    assert names(target.parent) == ["file.txt"]


def test_interrupted_file_leaves_the_old_one(tmp_path):
    target = tmp_path / "file.txt"
    target.write_text("old")

    with pytest.raises(StopNow):
        interrupted_file(target)

    assert target.read_text() == "old"
    assert names(tmp_path) == ["file.txt"]


def test_interrupted_folder_leaves_nothing(tmp_path):
    with pytest.raises(StopNow):
        interrupted_folder(tmp_path / "out")

    assert names(tmp_path) == []


def test_interrupted_folder_leaves_the_old_one(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "old.txt").write_text("old")

    with pytest.raises(StopNow):
        interrupted_folder(out, force=True)

    assert names(out) == ["old.txt"]
    assert names(tmp_path) == ["out"]


def test_forced_folder_replaces_the_old_one_as_a_whole(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "old.txt").write_text("old")

    with new_folder(out, force=True) as folder:
        (folder / "new.txt").write_text("new")

    assert names(out) == ["new.txt"]
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("occupied_by", ["file", "folder"])
def test_nothing_is_replaced_unasked(tmp_path, occupied_by):
    out = tmp_path / "out"
    if occupied_by == "file":
        out.write_text("old")
    else:
        out.mkdir()
        (out / "old.txt").write_text("old")

    with (
        pytest.raises(UsageError, match=r"out: exists already; choose another output or pass --force"),
        new_folder(out),
    ):
        pass

    assert out.exists()


def test_an_empty_folder_is_no_obstacle(tmp_path):
    (tmp_path / "out").mkdir()

    with new_folder(tmp_path / "out") as folder:
        (folder / "new.txt").write_text("new")

    assert names(tmp_path / "out") == ["new.txt"]
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o755


def test_sha256_of_a_known_text(tmp_path):
    write_text(tmp_path / "abc", "abc")

    assert sha256(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
