"""Files and folders that appear complete, or not at all, and one writer per stage folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base.atomic import exclusive, replacing, stage_folder, sweep
from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT
from tests.kitti_drive import contents, write

HOLDER = """
import sys
from pathlib import Path
from pipeline.base.atomic import exclusive
with exclusive(Path("stage"), Path(".resume/stage")):
    print("locked", flush=True)
    sys.stdin.read()
"""


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


def test_a_file_replaces_no_folder_and_no_device(tmp_path: Path) -> None:
    write(tmp_path / "folder/file", "content")
    write(tmp_path / "file", "content")
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    os.mkfifo(tmp_path / "pipe")
    before = contents(tmp_path / "folder")
    for name in ("folder", "link", "pipe"):
        with pytest.raises(InputError, match="expected"), replacing(tmp_path / name) as tmp:
            tmp.write_text("new")
    with (
        pytest.raises(InputError, match="expected a folder to replace, got a file"),
        replacing(tmp_path / "file") as tmp,
    ):
        tmp.mkdir()
    assert contents(tmp_path / "folder") == before
    assert (tmp_path / "file").read_text() == "content"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder", "link", "pipe"]


def test_two_writers_of_one_path_do_not_meet(tmp_path: Path) -> None:
    with replacing(tmp_path / "a") as first, replacing(tmp_path / "a") as second:
        assert first != second
        first.write_text("first")
        second.write_text("second")
    assert contents(tmp_path) == {"a": b"first"}, "the last to end"


def test_sweeping_removes_what_was_left_and_nothing_else(tmp_path: Path) -> None:
    unfinished = [replacing(tmp_path / name) for name in ("a.h5", "b.h5", "index.json", "drive")]
    paths = [context.__enter__() for context in unfinished]  # killed here
    for path in paths[:2]:
        path.write_text("half")
    write(paths[3] / "image/0.png", "half")
    write(paths[3].with_name("drive.old") / "image/0.png", "whole")
    for name in (".own.tmp", ".own.txt.12345678.tmp", "a.h5", ".a.h5.12345678.tmp/own", ".x.tmp/x", "below/.a.tmp/a"):
        write(tmp_path / name, "foreign")
    foreign = {name: content for name, content in contents(tmp_path).items() if content == b"foreign"}
    assert len(contents(tmp_path)) == len(foreign) + 4
    sweep(tmp_path)
    assert contents(tmp_path) == foreign
    assert len(list(tmp_path.iterdir())) == 6
    sweep(tmp_path / "nowhere")


def take(tmp_path: Path) -> None:
    with exclusive(tmp_path / "stage", tmp_path / ".resume/stage"):
        assert (tmp_path / ".resume/stage").is_dir()


def test_a_lock_is_released_whatever_ends_the_block(tmp_path: Path) -> None:
    take(tmp_path)
    with pytest.raises(ZeroDivisionError), exclusive(tmp_path / "stage", tmp_path / ".resume/stage"):
        raise ZeroDivisionError
    take(tmp_path)
    assert not (tmp_path / "stage").exists(), "nothing is written into the stage's folder"


def test_a_second_process_is_refused_until_the_first_ends_or_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(InputError) as raised:
            take(tmp_path)
        assert raised.value.where == str(tmp_path / "stage")
        with exclusive(tmp_path / "other", tmp_path / ".resume/other"):
            pass
        holder.kill()
    take(tmp_path)


def test_a_lock_file_that_is_a_link_is_refused_and_the_file_elsewhere_stays(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("content")
    (tmp_path / ".resume").mkdir()
    (tmp_path / ".resume/stage.lock").symlink_to(tmp_path / "precious")
    with pytest.raises(InputError) as raised:
        take(tmp_path)
    assert raised.value.where.endswith("stage.lock")
    assert (tmp_path / "precious").read_text() == "content"


def test_files_that_no_stage_wrote_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    out = Path("data/labels")
    write(out / "index.json", "precious")
    with pytest.raises(InputError, match="no stage wrote"), stage_folder(out):
        (out / "index.json").unlink()
    assert contents(tmp_path) == {"data/labels/index.json": b"precious"}
    write(Path("dvc.lock"), "outs:\n- path: data/labels-2\n")
    with pytest.raises(InputError, match="no stage wrote"), stage_folder(out):
        pass
    write(Path("dvc.lock"), "outs:\n- path: data/labels\n")  # as after dvc pull
    with stage_folder(out):
        pass
    Path("dvc.lock").unlink()
    with stage_folder(out):  # now there is a lock of an earlier run
        pass
