"""What a user does, on a small scratch copy: DVC's own verbs, a second machine, a network of one's own, a notebook."""

import csv
import io
import json
import re
import shutil
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from pipeline.base import resume, store
from pipeline.perception.scores import Scores
from tests import artefacts, scratch

pytestmark = pytest.mark.slow
MODEL = "sa-gnn-ncp"
NETWORK_STAGES = [f"train@{MODEL}", f"evaluate@{MODEL}", "report"]
SPLITS = {
    "2026_01_01_drive_0001": "train",
    "2026_01_02_drive_0001": "val",
    "2026_01_03_drive_0001": "test",
    "2026_01_03_drive_0002": "test",
}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scratch copy with one trained model, its labels, graphs and scores made of arithmetic."""
    folder = scratch.copy(tmp_path_factory.mktemp("trained"))
    params = folder / "params.yaml"
    params.write_text(re.sub(r"(?m)^  epochs: 12\b", "  epochs: 3", params.read_text()))
    artefacts.write_dataset(folder / "data", SPLITS, frames=210)
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["test"].add_depth("depth_dense", 1.1 * truth, truth)
    scores["test"].add_depth("ground_plane_dense", 1.5 * truth, truth)
    scores["test"].add_classes(np.array([[0, 0, 1, 1]]), np.array([[0, 0, 0, 1]]))
    store.write_json(folder / "data/scores/metrics.json", {split: score.report() for split, score in scores.items()})
    scratch.settle(folder)
    scratch.run(folder, "dvc", "repro", "--force", "--downstream", "train")
    scratch.commit(folder, "trained")
    return folder


@pytest.fixture(scope="module")
def swapped(trained: Path) -> Path:
    """The same after an experiment: the recurrent network is another."""
    output = scratch.run(trained, "dvc", "exp", "run", "-S", f"models.{MODEL}.temporal=lstm")
    assert [stage for stage in scratch.stages_run(output) if stage != "check"] == NETWORK_STAGES
    return trained


def nmse(folder: Path) -> float:
    return json.loads((folder / f"data/evaluate/{MODEL}/metrics.json").read_text())["test"]["nmse"]


def test_metrics_show_what_counts(swapped: Path) -> None:
    (shown,) = json.loads(scratch.run(swapped, "dvc", "metrics", "show", "--json")).values()
    figures = shown["data"]["data/report/metrics.json"]["data"]
    assert figures[f"{MODEL}.nmse"] == nmse(swapped)
    assert figures[f"{MODEL}.nmse_low"] <= figures[f"{MODEL}.nmse"] <= figures[f"{MODEL}.nmse_high"]
    assert figures["encoder.abs_rel_dense"] == pytest.approx(0.1)
    assert figures["encoder.miou"] == pytest.approx((2 / 3 + 1 / 2) / 2)
    assert f"{MODEL}.mae_deg" in figures


def test_an_experiment_edits_one_line_and_its_row_has_the_figure(swapped: Path) -> None:
    edits = [line for line in scratch.run(swapped, "git", "diff", "-U0", "params.yaml").splitlines() if line[0] in "+-"]
    before, after = edits[2:]  # after the names of the file
    assert before.split()[:3] == ["-", "temporal:", "ncp"]
    assert after.split()[:3] == ["+", "temporal:", "lstm"]
    rows = list(csv.DictReader(io.StringIO(scratch.run(swapped, "dvc", "exp", "show", "--csv"))))
    (experiment,) = (row for row in rows if row["typ"] == "branch_base")
    assert float(experiment[f"{MODEL}.nmse"]) == pytest.approx(nmse(swapped))
    assert experiment[f"models.{MODEL}.temporal"] == "lstm"
    (baseline,) = (row for row in rows if row["typ"] == "baseline" and row["rev"] != "workspace")
    assert baseline[f"models.{MODEL}.temporal"] == "ncp"
    assert baseline[f"{MODEL}.nmse"] != experiment[f"{MODEL}.nmse"]


def test_differences_name_the_knob_and_the_figures(swapped: Path) -> None:
    params = json.loads(scratch.run(swapped, "dvc", "params", "diff", "--json"))
    assert params == {"params.yaml": {f"models.{MODEL}.temporal": {"old": "ncp", "new": "lstm"}}}
    (metrics,) = json.loads(scratch.run(swapped, "dvc", "metrics", "diff", "--json")).values()
    assert metrics[f"{MODEL}.nmse"]["new"] == nmse(swapped) != metrics[f"{MODEL}.nmse"]["old"]


def test_plots_show_both_curves_of_each_kind(swapped: Path) -> None:
    plots = json.loads(scratch.run(swapped, "dvc", "plots", "diff", "HEAD", "workspace", "--json"))["data"]
    for kind, fields in (("learning", {"train_loss", "val_nmse"}), ("steering", {"driven_deg", "predicted_deg"})):
        (plot,) = plots[f"data/report/{kind}/{MODEL}.csv"]
        points = plot["content"]["data"]["values"]
        assert {(row["rev"], row["field"]) for row in points} == set(product(("HEAD", "workspace"), fields))
    scratch.run(swapped, "dvc", "plots", "show")
    assert (swapped / "dvc_plots/index.html").is_file()
    assert "dvc_plots" not in scratch.run(swapped, "git", "status", "--short")


def test_one_command_takes_a_second_machine_to_its_table(trained: Path, tmp_path: Path) -> None:
    """Labels, one variant and the scores are shared, no model is: it is trained there, once."""
    scratch.run(trained, "dvc", "remote", "add", "--force", "--default", "here", str(tmp_path / "remote"))
    scratch.run(trained, "dvc", "push", "labels", "graphs@semantic", "scores")
    second = tmp_path / "second"
    scratch.run(tmp_path, "git", "clone", "-q", str(trained), str(second))
    shutil.copyfile(trained / ".dvc/config", second / ".dvc/config")

    command = ("dvc", "repro", "--pull", "--downstream", f"train@{MODEL}")
    assert scratch.stages_run(scratch.run(second, *command)) == NETWORK_STAGES
    made = sorted(path.name for path in (second / "data").iterdir() if path.is_dir() and path.name != ".resume")
    assert made == ["evaluate", "graphs", "labels", "report", "scores", "train"]
    assert [path.name for path in (second / "data/graphs").iterdir()] == ["semantic"]
    table = (second / "data/report/table.md").read_text()
    assert re.search(rf"^\| {MODEL} +\| semantic \|", table, re.M)
    assert "mean IoU" in table

    assert scratch.stages_run(scratch.run(second, *command)) == []  # the next day
    params = second / "params.yaml"
    params.write_text(params.read_text().replace("semantics: 1.0", "semantics: 0.5"))
    assert scratch.stages_run(scratch.run(second, *command)) == NETWORK_STAGES


HEIGHT = '''"""How high the points of a frame lie on average: a network that ignores the graph."""

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.features import mean_max_pool

INPUT: Kind = "graph"


class network(nn.Module):
    def __init__(self, features: int, *, scale_m: float = 10.0) -> None:
        super().__init__()
        self.scale_m = scale_m
        self.read_out = nn.Linear(6, features)

    def forward(self, batch: GraphBatch) -> Tensor:
        return torch.tanh(self.read_out(mean_max_pool(batch.xyz / self.scale_m, batch.ptr)))
'''


def test_a_network_is_added_by_a_file_and_its_edit_trains_its_models_alone(trained: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(trained, folder, symlinks=True)
    file = folder / "models/steering/spatial/height.py"
    file.write_text(HEIGHT)
    assert scratch.changed(folder) == {"check"}  # whose dep is all of models/: nobody else sees the file
    line = "  mine: {input: semantic, spatial: height, temporal: lstm, window: 4, scale_m: 5.0}\n"
    params = (folder / "params.yaml").read_text()
    (folder / "params.yaml").write_text(params.replace(f"  {MODEL}:\n", f"{line}  {MODEL}:\n"))
    own = ["train@mine", "evaluate@mine"]
    assert [*own, "report"] == [
        name for name in scratch.stages_run(scratch.run(folder, "dvc", "repro")) if name != "check"
    ]
    assert re.search(
        r"^\| mine +\| semantic \|.* height \| +lstm \|", (folder / "data/report/table.md").read_text(), re.M
    )
    assert scratch.changed(folder) == set()

    file.write_text(HEIGHT.replace("10.0", "9.0"))
    assert scratch.changed(folder) == {"check", *own}
    other = folder / "models/steering/spatial/gatv2.py"
    other.write_text(other.read_text() + "# of nobody's\n")
    assert scratch.changed(folder) == {"check", *own}
    # What another network's file holds would go stale: DVC does not watch it for this model.
    file.write_text(HEIGHT.replace("import torch\n", "import torch\nfrom models.steering.spatial import gatv2\n", 1))
    output = scratch.run(folder, "dvc", "repro", "check", check=False)
    assert "error: params.yaml: models.mine.spatial" in output
    assert "gatv2.py" in output


def test_the_lines_of_readme_give_the_numbers_of_evaluate(trained: Path) -> None:
    (snippet,) = re.findall(r"```python\n(.*?)```", (resume.ROOT / "README.md").read_text(), re.DOTALL)
    assert len([line for line in snippet.splitlines() if line]) <= 6
    printed = scratch.run(trained, sys.executable, "-c", snippet + "\nprint(steering_rad.tolist(), graphs.path)")
    numbers, _, path = printed.partition("] ")
    frames = [int(number) for number in re.findall(r"\d+", re.search(r"graphs, \[(.*?)\]", snippet)[1])]
    with (trained / f"data/evaluate/{MODEL}/predictions.csv").open() as file:
        rows = {(row["drive"], int(row["frame"])): row["predicted_rad"] for row in csv.DictReader(file)}
    expected = [float(rows[Path(path.strip()).stem, frame]) for frame in frames]
    assert json.loads(numbers + "]") == pytest.approx(expected, abs=1e-6)
