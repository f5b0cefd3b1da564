"""Three machines: one has the raw data, one trains on its graphs, one computes other graphs; by SSH and by a folder."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml

from pipeline.base import store
from tests import scratch, sftp_server
from tests.scratch import MODEL

pytestmark = pytest.mark.slow
NETWORK = [f"train@{MODEL}", f"evaluate@{MODEL}", "report"]
DRIVE = "2026_01_01_drive_0001.h5"


def commands(part: str) -> list[str]:
    """Return the commands of a code block of the documentation."""
    return [line.partition("  #")[0].strip() for line in scratch.code_block(part).strip().splitlines()]


SHARE, TRAIN, GO_ON = commands("dvc remote add -d lab")
FIND, DELETE_LISTS, PUSH = commands("md5sum")  # how a remote is repaired


class Lab(NamedTuple):
    """The first machine, and what it shares."""

    first: Path
    folder: Path  # a remote with all outputs
    early: Path  # a clone from before a model was trained, with a remote by SSH


@pytest.fixture(scope="module")
def lab(chain: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """The small chain, shared twice: by SSH without a model, and by a folder with all outputs."""
    root = tmp_path_factory.mktemp("lab")
    for name in ("served", "home"):
        (root / name).mkdir()
    first = scratch.duplicate(chain, root / "first")
    lock = (first / "dvc.lock").read_text()
    content = yaml.safe_load(lock)
    content["stages"] = {name: entry for name, entry in content["stages"].items() if name not in NETWORK}
    with pytest.MonkeyPatch.context() as patch, sftp_server.serving(root / "served", root / "home") as port:
        patch.setenv("HOME", str(root / "home"))
        (first / "dvc.lock").write_text(yaml.safe_dump(content))
        share(first, f"ssh://127.0.0.1:{port}/steering")
        early = clone(first, root / "early")
        (first / "dvc.lock").write_text(lock)
        scratch.run(first, "dvc", "remote", "remove", "lab")
        share(first, str(root / "folder"))
        yield Lab(first, root / "folder", early)


def share(machine: Path, remote: str) -> None:
    """Run the documented commands, and commit."""
    typed(machine, SHARE.replace("/mnt/lab/steering", remote))
    scratch.commit(machine, "shared")


def typed(machine: Path, line: str, check: bool = True) -> str:
    """Run a line in a shell and return its output. Without `check` it must fail."""
    return scratch.run(machine, "sh", "-c", line, check=check)


def clone(machine: Path, folder: Path) -> Path:
    scratch.run(folder.parent, "git", "clone", "-q", str(machine), str(folder))
    return folder


def present(machine: Path) -> list[str]:
    """Return the stages, kinds of clouds and variants of graphs in a machine's data/."""
    inside = {path.relative_to(machine / "data") for path in (machine / "data").glob("[a-z]*/*")}
    return sorted({str(path) if path.parts[0] in ("clouds", "graphs") else path.parts[0] for path in inside})


def checkpoint(machine: Path) -> bytes:
    return (machine / f"data/train/{MODEL}/best.pt").read_bytes()


def test_a_second_machine_trains_the_same_network(lab: Lab) -> None:
    second = lab.early
    assert scratch.stages_run(typed(second, TRAIN)) == NETWORK
    needed = ["evaluate", "graphs/semantic", "labels", "report", "scores", "train"]
    assert present(second) == needed
    assert checkpoint(second) == checkpoint(lab.first)


@pytest.mark.soak
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
    assert present(third) == [*graphs_too, "train"]
    edges = {name: edges_of(third / f"data/graphs/{name}/{DRIVE}") for name in ("near", "pruned")}
    usual = edges_of(lab.first / f"data/graphs/semantic/{DRIVE}")
    assert 0 < edges["near"] < usual < edges["pruned"]


@pytest.mark.soak
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
    else:
        assert scratch.stages_run(output) == NETWORK[:1]
        (line,) = (line for line in output.splitlines() if line.startswith("error: "))
        assert f"data/labels/{DRIVE}" in line
        assert "dvc pull" in line

    for line in (FIND, DELETE_LISTS):
        typed(remote / "files/md5", line)
    typed(lab.first, f"{PUSH} --remote {remote.name} labels")
    if not verify:
        typed(second / ".dvc/cache/files/md5", FIND)
        shutil.rmtree(second / "data/labels")
    typed(second, "dvc pull labels")
    assert scratch.outputs(second, "labels") == scratch.outputs(lab.first, "labels")


def change(machine: Path, **line: object) -> None:
    """Change values of the model's entry in params.yaml."""
    models = yaml.safe_load((machine / "params.yaml").read_text())["models"]
    scratch.edit_params(machine, models=models | {MODEL: models[MODEL] | line})


def clone_with_a_remote(lab: Lab, folder: Path) -> tuple[Path, Path]:
    """Return a new machine and its own copy of the remote, which the first machine has as a remote of that name."""
    remote = folder / f"remote-{folder.name}"
    shutil.copytree(lab.folder, remote)
    scratch.run(lab.first, "dvc", "remote", "add", "--local", remote.name, str(remote))
    machine = clone(lab.first, folder / "second")
    scratch.run(machine, "dvc", "remote", "modify", "lab", "url", str(remote))
    return machine, remote


def object_of(machine: Path, remote: Path) -> Path:
    """Return the path of a drive's labels in a remote."""
    folder = remote / "files/md5"
    (out,) = yaml.safe_load((machine / "dvc.lock").read_text())["stages"]["labels"]["outs"]
    listed = json.loads((folder / out["md5"][:2] / out["md5"][2:]).read_text())
    (name,) = (entry["md5"] for entry in listed if entry["relpath"] == DRIVE)
    return folder / name[:2] / name[2:]


def edges_of(path: Path) -> int:
    with store.DriveReader(path, stage="graphs") as file:
        return file.shape("indices")[0]
