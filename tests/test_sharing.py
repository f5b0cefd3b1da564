"""Two machines: one has the raw data, the other trains on its graphs."""

from pathlib import Path

import pytest
import yaml

from tests import scratch
from tests.scratch import MODEL

pytestmark = pytest.mark.slow
NETWORK = [f"train@{MODEL}", f"evaluate@{MODEL}", "report"]


def commands(part: str) -> list[str]:
    """Return the commands of a code block of the documentation."""
    return [line.partition("  #")[0].strip() for line in scratch.code_block(part).strip().splitlines()]


SHARE, TRAIN, _ = commands("dvc remote add -d lab")


@pytest.fixture(scope="module")
def first(chain: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The machine with all data; it has shared everything but the model through a folder."""
    root = tmp_path_factory.mktemp("lab")
    first = scratch.duplicate(chain, root / "first")
    lock = (first / "dvc.lock").read_text()
    content = yaml.safe_load(lock)
    content["stages"] = {name: entry for name, entry in content["stages"].items() if name not in NETWORK}
    (first / "dvc.lock").write_text(yaml.safe_dump(content))
    share(first, str(root / "folder"))
    return first


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


def test_a_second_machine_trains_the_same_network(first: Path, tmp_path: Path) -> None:
    second = clone(first, tmp_path / "second")
    assert scratch.stages_run(typed(second, TRAIN)) == NETWORK
    needed = ["evaluate", "graphs/semantic", "labels", "report", "scores", "train"]
    assert present(second) == needed
    assert checkpoint(second) == checkpoint(first)
