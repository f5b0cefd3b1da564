"""Files and folders that appear complete, or not at all."""

from pathlib import Path

import pytest

from pipeline.base.atomic import replacing, sweep
from tests.kitti_drive import contents, write


def test_a_file_takes_the_place_of_another(tmp_path: Path) -> None:
    path = tmp_path / "new/folder/a.h5"
    for text in ("first", "second"):
        with replacing(path) as tmp:
            tmp.write_text(text)
            assert tmp.suffix == ".h5", "by which some writers choose the format"
            assert path.exists() == (text == "second")
        assert contents(tmp_path) == {"new/folder/a.h5": text.encode()}


@pytest.mark.parametrize("folder", [False, True])
def test_an_error_leaves_what_was_there(tmp_path: Path, folder: bool) -> None:
    path = tmp_path / "a"
    write(path / "below" if folder else path, "before")
    before = contents(tmp_path)
    with pytest.raises(ZeroDivisionError), replacing(path) as tmp:  # noqa: PT012
        write(tmp / "half" if folder else tmp, "half")
        raise ZeroDivisionError
    assert contents(tmp_path) == before
    with pytest.raises(FileNotFoundError), replacing(path):
        pass  # a block that writes nothing
    assert contents(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_two_writers_of_one_path_do_not_meet(tmp_path: Path) -> None:
    with replacing(tmp_path / "a") as first, replacing(tmp_path / "a") as second:
        assert first != second
        first.write_text("first")
        second.write_text("second")
    assert contents(tmp_path) == {"a": b"first"}, "the last to end"


def test_sweeping_removes_what_was_left_and_nothing_else(tmp_path: Path) -> None:
    left = [replacing(tmp_path / name) for name in ("a.h5", "b.h5", "index.json", "drive")]
    paths = [one.__enter__() for one in left]  # killed here
    for path in paths[:2]:
        path.write_text("half")
    write(paths[3] / "image/0.png", "half")
    write(paths[3].with_name("drive.old") / "image/0.png", "whole")
    for name in (".own.tmp", ".own.txt.12345678.tmp", "a.h5", ".a.h5.12345678.tmp/own", ".x.tmp/x", "below/.a.tmp/a"):
        write(tmp_path / name, "own")
    own = {name: content for name, content in contents(tmp_path).items() if content == b"own"}
    assert len(contents(tmp_path)) == len(own) + 4
    sweep(tmp_path)
    assert contents(tmp_path) == own
    assert len(list(tmp_path.iterdir())) == 6
    sweep(tmp_path / "nowhere")
