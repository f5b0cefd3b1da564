"""Three machines: one has the raw data, one trains on its graphs, one computes other graphs; by SSH and by a folder."""

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


def edges_of(path: Path) -> int:
    with store.DriveReader(path, stage="graphs") as file:
        return file.shape("indices")[0]
