"""Three machines: one has the raw data, one trains on its graphs, one makes other graphs. By SSH, and by a folder."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import h5py
import pytest
import yaml

from pipeline.base import provenance
from tests import kills, scratch, sftp_server

pytestmark = pytest.mark.slow
MODEL = "sa-gnn-ncp"
NETWORK = [f"train@{MODEL}", f"evaluate@{MODEL}", "report"]
DRIVE = "2026_01_01_drive_0001.h5"


def of_readme() -> list[str]:
    """Return the commands of README's section on sharing."""
    text = (provenance.ROOT / "README.md").read_text()
    block = text.partition("## Share it")[2].split("```")[1]
    return [line.partition("  #")[0].strip() for line in block.strip().splitlines()]


SHARE, TRAIN, GO_ON = of_readme()


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
        scratch.run(first, "dvc", "repro", "labels", "graphs@semantic", "scores")
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
    """Return what a machine's data/ holds, each variant of clouds and graphs by itself."""
    inside = (path.relative_to(machine / "data") for path in (machine / "data").glob("*/*"))
    return sorted({str(path) if path.parts[0] in ("clouds", "graphs") else path.parts[0] for path in inside} - {".resume"})


def checkpoint(machine: Path) -> bytes:
    return (machine / f"data/train/{MODEL}/best.pt").read_bytes()


def test_a_second_machine_trains_the_same_network_and_goes_on(lab: Lab) -> None:
    second = lab.early
    assert scratch.stages_run(typed(second, TRAIN)) == NETWORK
    needed = ["evaluate", "graphs/semantic", "labels", "report", "scores", "train"]
    assert holds(second) == needed
    assert checkpoint(second) == checkpoint(lab.first)

    params = yaml.safe_load((second / "params.yaml").read_text())
    params["models"][MODEL]["temporal"] = "lstm"
    scratch.edit_params(second, **params)
    assert scratch.stages_run(typed(second, GO_ON)) == ["check", *NETWORK]
    assert holds(second) == needed
    assert checkpoint(second) != checkpoint(lab.first)


def test_a_third_machine_makes_other_graphs_of_the_clouds(lab: Lab, tmp_path: Path) -> None:
    third = clone(lab.first, tmp_path / "third")
    params = yaml.safe_load((third / "params.yaml").read_text())
    graphs, model = params["graphs"]["semantic"], params["models"][MODEL]
    scratch.edit_params(
        third,
        graphs={"semantic": graphs, "near": graphs | {"k": 3}, "pruned": graphs | {"keep_inter_class": 0.0}},
        models={MODEL: model, "near": model | {"input": "near"}, "pruned": model | {"input": "pruned"}},
    )
    ran = scratch.stages_run(typed(third, GO_ON))
    assert sorted(ran) == sorted(
        ["check", "report", *(f"{stage}@{name}" for stage in ("graphs", "train", "evaluate") for name in ("near", "pruned"))]
    )
    print(holds(third))
