"""What an edit costs: which stages `dvc status` wants to run again after a file of each kind was touched."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import scratch

pytestmark = pytest.mark.slow
MODELS = {
    "plain": {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": 8},
    "attention": {"input": "semantic", "spatial": "gatv2", "temporal": "lstm", "window": 8},
}
NETWORKS = {"encoder", "perception", "train@plain", "train@attention"}  # what runs one for hours


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = scratch.copy(tmp_path_factory.mktemp("project"))
    scratch.edit_params(folder, models=MODELS, graphs={"semantic": {"source": "clouds/pseudo", "points": 100, "k": 6}})
    scratch.settle(folder)
    return folder


@pytest.fixture
def edit(project: Path) -> Iterator[object]:
    """Return a function that touches a file and says what would run; the file is as before afterwards."""
    before: dict[Path, bytes | None] = {}

    def touch(name: str) -> set[str]:
        path = project / name
        before[path] = path.read_bytes() if path.exists() else None
        path.write_bytes((before[path] or b"") + b"# an edit\n")
        return scratch.changed(project) - {"check"}

    yield touch
    for path, content in before.items():
        path.unlink() if content is None else path.write_bytes(content)


@pytest.mark.parametrize(
    ("file", "stages"),
    [
        ("pipeline/report/judge/interval.py", {"evaluate@plain", "evaluate@attention", "report"}),
        ("pipeline/report/judge/errors.py", {"evaluate@plain", "evaluate@attention"}),
        ("pipeline/report/judge/predictions.py", {"evaluate@plain", "evaluate@attention"}),
        ("pipeline/report/judge/decisions.py", {"evaluate@plain", "evaluate@attention"}),
        ("pipeline/report/tables.py", {"report"}),
        ("pipeline/report/page/page.html.j2", {"report"}),
        ("pipeline/report/studies.py", {"report"}),
        ("pipeline/report/street_view.py", {"pictures", "report"}),
        ("pipeline/perception/scores.py", {"scores"}),
        ("pipeline/perception/motion_scores.py", {"scores"}),
        ("stages/scores.py", {"scores"}),
    ],
)
def test_judging_and_showing_run_no_network_for_hours(edit, file: str, stages: set[str]) -> None:
    changed = edit(file)
    assert changed == stages
    assert not changed & NETWORKS


@pytest.mark.parametrize("file", ["fit", "augment", "score", "windows", "frames", "predict"])
def test_the_trainer_runs_neither_encoder_nor_graphs(edit, file: str) -> None:
    models = {"plain", "attention"}
    judged = {"report"} if file == "score" else set()  # claims are judged by it
    assert edit(f"pipeline/train/{file}.py") == judged | {
        f"{stage}@{model}" for stage in ("train", "evaluate") for model in models
    }


@pytest.mark.parametrize(
    ("file", "models"),
    [
        ("models/steering/spatial/gnn.py", {"plain"}),
        ("models/steering/spatial/gatv2.py", {"attention"}),
        ("models/steering/spatial/pointnet2.py", set()),
        ("models/steering/spatial/of_my_own.py", set()),
        ("models/steering/temporal/lstm.py", {"attention"}),
        ("models/steering/temporal/ncp.py", {"plain"}),
        ("models/steering/core/steering_net.py", {"plain", "attention"}),
        ("models/steering/core/cell/cfc.py", {"plain", "attention"}),  # DVC cannot depend on a key that a line may lack
    ],
)
def test_a_network_trains_the_models_that_use_it(edit, file: str, models: set[str]) -> None:
    assert edit(file) == {f"{stage}@{model}" for stage in ("train", "evaluate") for model in models}


@pytest.mark.parametrize(
    ("file", "stages"),
    [
        ("pipeline/encoder/fit.py", {"encoder"}),
        ("pipeline/encoder/examples.py", {"encoder"}),
        ("models/encoder/backbones/swin.py", {"encoder", "perception", "scores"}),
        ("pipeline/perception/ground_plane.py", {"perception", "scores"}),  # perception.reach needs it, too
        # The angle that measured motion says: scores judge it, and a network with motion adds to it.
        (
            "pipeline/label.py",
            {
                "labels",
                "scores",
                "report",
                *(f"{stage}@{model}" for stage in ("train", "evaluate") for model in MODELS),
            },
        ),
        ("pipeline/motion/pose.py", {"motion"}),
        ("pipeline/graphs/neighbourhoods.py", {"graphs@semantic"}),
        ("pipeline/graphs/cloud.py", {"clouds", "graphs@semantic"}),
        ("pipeline/town/street.py", {"town"}),
        ("pipeline/sections/train.py", {"train@plain", "train@attention"}),
    ],
)
def test_other_edits_run_their_own_stage(edit, file: str, stages: set[str]) -> None:
    assert edit(file) == stages


@pytest.mark.parametrize(
    "file",
    ["pipeline/train/__pycache__/fit.cpython-311.pyc", "pipeline/train/.fit.py.swp", "models/steering/core/x.py~"],
)
def test_what_an_editor_leaves_behind_runs_nothing(edit, project: Path, file: str) -> None:
    (project / file).parent.mkdir(exist_ok=True)
    assert edit(file) == set()


def test_no_name_runs_as_a_command(project: Path, tmp_path: Path) -> None:
    """DVC puts a name into the command as it is, and `check` does not stand before a single stage."""
    folder = tmp_path / "copy"
    shutil.copytree(project, folder, symlinks=True)
    name = "x';touch pwned;'$(touch pwned)\"`touch pwned`"
    scratch.edit_params(folder, graphs={name: {"source": "clouds/pseudo", "points": 100, "k": 6}})
    output = scratch.run(folder, "dvc", "repro", "graphs", check=False)
    assert "error:" in output
    assert "graphs" in output
    assert not (folder / "pwned").exists()
