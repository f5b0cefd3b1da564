"""The rules for output: a command writes where nothing is, a stage replaces its own files; files appear complete."""

from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.base.outputs import check_free, claim, stage_folder
from pipeline.base.store import read_json, replacing, write_json
from tests.kitti_drive import contents, write


def test_a_file_appears_complete_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "new/folder/a.h5"
    for text in ("first", "second"):
        with replacing(path) as tmp:
            tmp.write_text(text)
            assert tmp.suffix == ".h5", "by which some writers choose the format"
            assert path.exists() == (text == "second")
        assert contents(tmp_path) == {"new/folder/a.h5": text.encode()}
    with pytest.raises(ZeroDivisionError), replacing(path) as tmp:  # noqa: PT012
        tmp.write_text("half")
        raise ZeroDivisionError
    with pytest.raises(FileNotFoundError), replacing(path):
        pass  # a block that writes nothing
    assert contents(tmp_path) == {"new/folder/a.h5": b"second"}


def publish(out: Path, *files: str, stage: str = "labels", shared: bool = False) -> None:
    with stage_folder(stage, out, shared=shared) as folder:
        for file in files:
            write(folder.new / file, file)


def listed(out: Path) -> list[str]:
    return list(read_json(out / "index.json", stage="labels")["files"])


def test_a_stage_replaces_its_files_and_no_others(tmp_path: Path) -> None:
    out = tmp_path / "data/labels"
    publish(out, "a.h5", "below/old.h5")
    write(out / "a.h5", "earlier")
    write(out / "below/own.txt", "foreign")
    publish(out, "a.h5", "b.h5")
    assert listed(out) == ["a.h5", "b.h5"]
    files = {name: content.decode() for name, content in contents(out).items() if name != "index.json"}
    assert files == {"a.h5": "a.h5", "b.h5": "b.h5", "below/own.txt": "foreign"}
    write(out / "c.h5", "foreign")
    with pytest.raises(InputError, match="no stage wrote"):
        publish(out, "a.h5", "c.h5")
    assert listed(out) == ["a.h5", "b.h5"]
    assert (out / "c.h5").read_text() == "foreign"


@pytest.mark.parametrize(
    ("existing", "stage", "shared", "problem"),
    [
        ({"notes.txt": "foreign"}, "labels", False, "no stage wrote"),
        ({"index.json": '{"stage": "ingest", "entry": "", "files": ["a.h5"]}', "a.h5": "x"}, "labels", False, "labels"),
        ({"index.json": '{"stage": "train", "entry": "b", "files": []}'}, "train@a", False, "train@a"),
        ({"index.json": '{"own": 1}'}, "labels", True, "labels"),
        ({"a.h5": "foreign"}, "report", True, "no stage wrote"),
        ({"page.html": "foreign"}, "report", True, ""),
        ({".DS_Store": "foreign"}, "labels", False, ""),
    ],
)
def test_a_folder_of_others_is_refused(
    tmp_path: Path, existing: dict[str, str], stage: str, shared: bool, problem: str
) -> None:
    out = tmp_path / "data/out"
    for name, content in existing.items():
        write(out / name, content)
    before = contents(out)
    if problem:
        with pytest.raises(InputError, match=problem):
            publish(out, "a.h5", stage=stage, shared=shared)
        assert contents(out) == before
    else:
        publish(out, "a.h5", stage=stage, shared=shared)
        assert contents(out).items() > before.items()


def test_an_error_changes_nothing_and_an_index_from_elsewhere_deletes_nothing_outside(tmp_path: Path) -> None:
    out = tmp_path / "data/labels"
    publish(out, "a.h5")
    before = contents(out)
    with pytest.raises(ZeroDivisionError), stage_folder("labels", out) as folder:  # noqa: PT012
        write(folder.new / "b.h5", "half")
        raise ZeroDivisionError
    assert contents(out) == before
    write(tmp_path / "precious", "foreign")
    files = ["a.h5", "../../precious", str(tmp_path / "precious")]
    write_json(out / "index.json", {"stage": "labels", "entry": "", "files": files})
    publish(out, "b.h5")
    assert contents(out).keys() == {"b.h5", "index.json"}
    assert (tmp_path / "precious").read_text() == "foreign"


def test_state_that_a_run_does_not_use_is_removed_after_success(tmp_path: Path) -> None:
    out = tmp_path / "data/train/net"
    for used in ("first", "second"):
        with stage_folder("train@net", out) as folder:
            assert folder.kept == tmp_path / "data/.drives/train-net"
            write(folder.kept / f"{used}.pt", "state")
            folder.used.add(folder.kept / f"{used}.pt")
    assert contents(tmp_path / "data/.drives").keys() == {"train-net/second.pt", "train-net.lock"}


@pytest.mark.parametrize(
    ("existing", "expected"),
    [
        ([], "ride"),
        (["ride/poses.txt"], "ride-2"),
        (["ride/poses.txt", "ride-2/.work/other/a.h5"], "ride-3"),
        (["ride/.work/key/a.h5"], "ride"),
        (["ride/.work/key/a.h5", "ride/poses.txt"], "ride-2"),
        (["ride-3/.work/key/a.h5"], "ride-3"),
        (["ride"], "ride-2"),
    ],
)
def test_a_command_takes_the_first_free_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, existing: list[str], expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in existing:
        write(Path("out") / name, "foreign")
    before = contents(tmp_path)
    assert claim(None, "ride", "key") == Path("out") / expected
    named = Path("out/ride")
    if named.exists() and expected != "ride":
        with pytest.raises(InputError, match="Pass another --out"):
            claim(named, "ride", "key")
    else:
        assert claim(named, "ride", "key") == named
    assert contents(tmp_path) == before


def test_an_empty_folder_is_free_and_a_file_is_not(tmp_path: Path) -> None:
    check_free(tmp_path / "new.json")
    check_free(tmp_path)
    write(tmp_path / "old.json", "foreign")
    with pytest.raises(InputError, match="exists already"):
        check_free(tmp_path / "old.json")


def test_a_second_writer_of_a_folder_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "data/labels"
    with stage_folder("labels", out), pytest.raises(InputError, match="another process"), stage_folder("labels", out):
        pass
