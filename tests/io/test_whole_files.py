"""Results are there whole, or not at all."""

import os
import stat

import pytest

from longreach.errors import LongreachError
from longreach.io.whole_files import check_folder, whole_file, whole_folder, write_text


def everything_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def half_write(path, error):
    path.write_text("half")
    raise error


def test_a_file_is_written_and_nothing_else_is_left(tmp_path):
    write_text(tmp_path / "deep" / "a.txt", "θ\n")
    assert (tmp_path / "deep" / "a.txt").read_text(encoding="utf-8") == "θ\n"
    assert everything_in(tmp_path) == ["deep", "deep/a.txt"]


def test_a_file_is_made_with_the_rights_that_open_gives(tmp_path):
    (tmp_path / "opened").touch()
    write_text(tmp_path / "a.txt", "text")
    with whole_folder(tmp_path / "folder") as folder:
        (folder / "b.txt").touch()
    (tmp_path / "made").mkdir()
    rights = {name: stat.S_IMODE(os.stat(tmp_path / name).st_mode) for name in ("opened", "a.txt", "folder", "made")}
    assert rights["a.txt"] == rights["opened"]
    assert rights["folder"] == rights["made"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_file_that_failed_halfway_leaves_the_old_one(tmp_path, error):
    write_text(tmp_path / "a.txt", "old")
    with pytest.raises(error), whole_file(tmp_path / "a.txt") as temporary:
        half_write(temporary, error)
    assert (tmp_path / "a.txt").read_text() == "old"
    assert everything_in(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("there", [True, False])
def test_a_folder_that_failed_halfway_leaves_what_was_there(tmp_path, error, there):
    out = tmp_path / "out"
    if there:
        write_text(out / "a.txt", "old")
        write_text(out / "mine.txt", "mine")
    before = everything_in(tmp_path)
    with pytest.raises(error), whole_folder(out) as temporary:
        half_write(temporary / "a.txt", error)
    assert everything_in(tmp_path) == before
    if there:
        assert (out / "a.txt").read_text() == "old"


def test_files_of_a_folder_take_the_place_of_old_ones_and_others_stay(tmp_path):
    out = tmp_path / "out"
    write_text(out / "a.txt", "old")
    write_text(out / "figures" / "mine.png", "mine")
    with whole_folder(out) as temporary:
        assert (out / "a.txt").read_text() == "old"
        (temporary / "a.txt").write_text("new")
        (temporary / "figures").mkdir()
        (temporary / "figures" / "b.png").write_text("new")
    assert everything_in(tmp_path) == ["out", "out/a.txt", "out/figures", "out/figures/b.png", "out/figures/mine.png"]
    assert (out / "a.txt").read_text() == "new"
    assert (out / "figures" / "mine.png").read_text() == "mine"


def test_a_folder_in_a_folder_that_is_not_there_is_made(tmp_path):
    with whole_folder(tmp_path / "a" / "b") as temporary:
        (temporary / "c").touch()
    assert everything_in(tmp_path) == ["a", "a/b", "a/b/c"]


def test_a_file_where_the_folder_should_be_is_said(tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(LongreachError, match="out is a file; give a folder"), whole_folder(tmp_path / "out"):
        pass
    assert (tmp_path / "out").read_text() == "mine"


def test_a_place_that_cannot_be_written_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(LongreachError, match=r"a.txt cannot be written: "):
        write_text(tmp_path / "file" / "a.txt", "text")
    with pytest.raises(LongreachError, match=r"out cannot be written: "), whole_folder(tmp_path / "file" / "out"):
        pass


def test_a_folder_that_cannot_be_made_is_said_beforehand(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(LongreachError, match=r"nothing can be made in .*file"):
        check_folder(tmp_path / "file" / "out")
    with pytest.raises(LongreachError, match="file is a file; give a folder"):
        check_folder(tmp_path / "file")
    check_folder(tmp_path / "new" / "deeper")
    assert everything_in(tmp_path) == ["file"]
