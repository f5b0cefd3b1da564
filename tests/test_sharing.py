"""Three machines: one has the raw data, one trains on its graphs, one makes other graphs. By SSH, and by a folder."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import h5py
import pytest
import yaml

from pipeline.base import resume, store
from tests import kills, scratch, sftp_server

pytestmark = pytest.mark.slow
MODEL = "sa-gnn-ncp"
NETWORK = [f"train@{MODEL}", f"evaluate@{MODEL}", "report"]
DRIVE = "2026_01_01_drive_0001.h5"


def commands(page: str, section: str) -> list[str]:
    """Return the commands of the first block in a section of a page."""
    block = (resume.ROOT / page).read_text().partition(section)[2].split("```")[1]
    return [line.partition("  #")[0].strip() for line in block.strip().splitlines()]


SHARE, TRAIN, GO_ON = commands("docs/sharing.md", "## Push and pull")
FIND, LOOK_AGAIN, PUSH = commands("docs/sharing.md", "## Repair a damaged remote")  # how a remote is mended


class Lab(NamedTuple):
    """The first machine, and where others get what it made."""

    first: Path
    folder: Path  # a remote with all of it
    early: Path  # a clone from before a model was trained, which knows a remote by SSH


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A chain of a small sample, shared twice: by SSH before a model was trained, and by a folder when all was made."""
    root = tmp_path_factory.mktemp("lab")
    for name in ("served", "home"):
        (root / name).mkdir()
    first = kills.small(root / "first")
    params = yaml.safe_load((first / "params.yaml").read_text())
    scratch.edit_params(first, train=params["train"] | {"epochs": 3, "seeds": [0]})
    with pytest.MonkeyPatch.context() as patch, sftp_server.serving(root / "served", root / "home") as port:
        patch.setenv("HOME", str(root / "home"))
        scratch.run(first, "dvc", "repro", "labels", "graphs@semantic", "scores", "pictures")
        share(first, f"ssh://127.0.0.1:{port}/steering")
        early = clone(first, root / "early")
        scratch.run(first, "dvc", "repro")
        scratch.run(first, "dvc", "remote", "remove", "lab")
        share(first, str(root / "folder"))
        yield Lab(first, root / "folder", early)


def share(machine: Path, remote: str) -> None:
    """Do what README says, and commit."""
    typed(machine, SHARE.replace("/mnt/lab/steering", remote))
    scratch.commit(machine, "shared")


def typed(machine: Path, line: str, check: bool = True) -> str:
    """Run a line as it would be typed; return what it printed. With `check` off it must fail."""
    return scratch.run(machine, "sh", "-c", line, check=check)


def clone(machine: Path, folder: Path) -> Path:
    scratch.run(folder.parent, "git", "clone", "-q", str(machine), str(folder))
    return folder


def holds(machine: Path) -> list[str]:
    """Return what a machine's data/ holds: stages, kinds of clouds, variants of graphs."""
    inside = {path.relative_to(machine / "data") for path in (machine / "data").glob("[a-z]*/*")}
    return sorted({str(path) if path.parts[0] in ("clouds", "graphs") else path.parts[0] for path in inside})


def checkpoint(machine: Path) -> bytes:
    return (machine / f"data/train/{MODEL}/best.pt").read_bytes()


def test_a_second_machine_trains_the_same_network_and_goes_on(lab: Lab) -> None:
    second = lab.early
    assert scratch.stages_run(typed(second, TRAIN)) == NETWORK
    needed = ["evaluate", "graphs/semantic", "labels", "report", "scores", "train"]
    assert holds(second) == needed
    assert checkpoint(second) == checkpoint(lab.first)

    change(second, temporal="lstm")
    assert scratch.stages_run(typed(second, GO_ON)) == ["check", *NETWORK]
    assert holds(second) == needed
    assert checkpoint(second) != checkpoint(lab.first)


def test_a_third_machine_makes_other_graphs_of_the_clouds(lab: Lab, tmp_path: Path) -> None:
    third = clone(lab.first, tmp_path / "third")
    params = yaml.safe_load((third / "params.yaml").read_text())
    graphs, model = params["graphs"]["semantic"], params["models"][MODEL]
    params["graphs"] |= {"near": graphs | {"k": 3}, "pruned": graphs | {"keep_inter_class": 0.5}}
    params["models"] |= {name: model | {"input": name} for name in ("near", "pruned")}
    scratch.edit_params(third, **params)
    own = {f"{stage}@{name}" for stage in ("graphs", "train", "evaluate") for name in ("near", "pruned")}
    assert set(scratch.stages_run(typed(third, GO_ON))) == own | {"check", "report"}
    graphs_too = ["clouds/pseudo", "evaluate", "graphs/near", "graphs/pruned", "labels", "motion", "report", "scores"]
    assert holds(third) == [*graphs_too, "train"]
    edges = {name: edges_of(third / f"data/graphs/{name}/{DRIVE}") for name in ("near", "pruned")}
    usual = edges_of(lab.first / f"data/graphs/semantic/{DRIVE}")
    assert 0 < edges["near"] < usual < edges["pruned"]


@pytest.mark.parametrize("verify", [True, False])
def test_a_half_copied_object_is_refused_and_the_way_out_works(lab: Lab, tmp_path: Path, verify: bool) -> None:
    second, remote = clone_with_a_remote(lab, tmp_path)
    scratch.run(second, "dvc", "remote", "modify", "lab", "verify", str(verify).lower())
    half = object_of(lab.first, remote)
    half.chmod(0o644)
    half.write_bytes(half.read_bytes()[: half.stat().st_size // 2])
    half.chmod(0o444)
    change(second, semantics=0.5)

    output = typed(second, TRAIN, check=False)
    assert not (second / f"data/train/{MODEL}").exists()
    assert "Traceback" not in output
    if verify:
        assert "data/labels" in output
        assert scratch.stages_run(output) == []
        assert not (second / "data/labels").exists()
    else:  # the copy is taken for what it should be
        assert scratch.stages_run(output) == NETWORK[:1]
        (line,) = (line for line in output.splitlines() if line.startswith("error: "))
        assert f"data/labels/{DRIVE} is damaged" in line
        assert f"fetch it: dvc pull data/labels/{DRIVE} " in line

    for line in (FIND, LOOK_AGAIN):
        typed(remote / "files/md5", line)
    typed(lab.first, f"{PUSH} --remote {remote.name} labels")
    if not verify:
        typed(second / ".dvc/cache/files/md5", FIND)
        shutil.rmtree(second / "data/labels")
    typed(second, "dvc pull labels")
    assert scratch.files_of(second, ["labels"]) == scratch.files_of(lab.first, ["labels"])


def test_what_another_schema_made_is_named_and_trains_nothing(lab: Lab, tmp_path: Path) -> None:
    old, remote = tmp_path / "old", tmp_path / "remote"
    shutil.copytree(lab.first, old, ignore=shutil.ignore_patterns("town", "cache"))
    with h5py.File(old / f"data/labels/{DRIVE}", "r+") as file:
        file.attrs["schema"] = 1
    scratch.run(old, "dvc", "commit", "--force", "labels")
    shutil.copytree(lab.folder, remote)
    scratch.run(old, "dvc", "remote", "modify", "lab", "url", str(remote))
    scratch.run(old, "dvc", "push", "labels")
    scratch.commit(old, "of another schema")

    second = clone(old, tmp_path / "second")
    output = typed(second, TRAIN, check=False)
    (line,) = (line for line in output.splitlines() if line.startswith("error: "))
    assert line.startswith(f"error: data/labels/{DRIVE} has stage 'labels', schema 1; this code reads")
    assert line.endswith("git pull, dvc pull labels")
    assert not (second / f"data/train/{MODEL}").exists()


def test_what_a_remote_lacks_trains_nothing(lab: Lab, tmp_path: Path) -> None:
    second, remote = clone_with_a_remote(lab, tmp_path)
    object_of(lab.first, remote).unlink()
    change(second, semantics=0.5)
    for line in (TRAIN, GO_ON):
        output = typed(second, line, check=False)
        assert f"failed to reproduce 'train@{MODEL}'" in output
        assert set(scratch.stages_run(output)) <= {"check"}
        assert not (second / f"data/train/{MODEL}").exists()


def change(machine: Path, **line: object) -> None:
    """Change words of the model's entry in params.yaml."""
    models = yaml.safe_load((machine / "params.yaml").read_text())["models"]
    scratch.edit_params(machine, models=models | {MODEL: models[MODEL] | line})


def clone_with_a_remote(lab: Lab, folder: Path) -> tuple[Path, Path]:
    """Return a new machine and a copy of the folder's remote, which the first machine knows by that copy's name."""
    remote = folder / f"remote-{folder.name}"
    shutil.copytree(lab.folder, remote)
    scratch.run(lab.first, "dvc", "remote", "add", "--local", remote.name, str(remote))
    machine = clone(lab.first, folder / "second")
    scratch.run(machine, "dvc", "remote", "modify", "lab", "url", str(remote))
    return machine, remote


def object_of(machine: Path, remote: Path) -> Path:
    """Return where a remote keeps the labels of a drive."""
    folder = remote / "files/md5"
    (out,) = yaml.safe_load((machine / "dvc.lock").read_text())["stages"]["labels"]["outs"]
    listed = json.loads((folder / out["md5"][:2] / out["md5"][2:]).read_text())
    (name,) = (entry["md5"] for entry in listed if entry["relpath"] == DRIVE)
    return folder / name[:2] / name[2:]


def edges_of(path: Path) -> int:
    with store.DriveReader(path, stage="graphs") as file:
        return file.shape("indices")[0]
