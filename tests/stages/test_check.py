from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.encoder import download, weights
from pipeline.report.tables.paper import PAPER
from stages import check

ROOT = Path(__file__).resolve().parents[2]
FIT = {"epochs": 1, "frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}
PRECOMPUTED = {"backbone": "precomputed", **FIT}
OTHERS = ["params.kitti.yaml", "params.table2.yaml", "params.replay.yaml", "params.real.yaml"]


@pytest.mark.parametrize("name", ["params.yaml", *OTHERS])
def test_the_projects_own_files_are_right(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the weights lie that nothing fetches; none is read, none fetched."""

    def never(*_: object) -> None:
        raise AssertionError("check reads or fetches weights")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(download, "file_hash", never)
    monkeypatch.setattr(download, "_fetch", never)
    (tmp_path / "weights").mkdir()
    encoder = yaml.safe_load((ROOT / name).read_text())["encoder"]
    for file in weights.files(encoder["weights"], "encoder.weights").values():
        if "#sha256=" not in file:
            (tmp_path / "weights" / file.rsplit("/", 1)[-1]).touch()
    check.main(ROOT / name)


def test_weights_that_nothing_will_fetch_are_missed_before_ingest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as checked:
        check.main(ROOT / "params.kitti.yaml")
    key = "encoder.weights.depth_head"
    with pytest.raises(InputError, match=rf"^{key}: weights/.*head\.pth is missing.*: curl ") as found:
        download.find(yaml.safe_load((ROOT / "params.kitti.yaml").read_text())["encoder"]["weights"]["depth_head"], key)
    assert str(checked.value) == str(found.value)


@pytest.mark.parametrize("name", OTHERS)
def test_the_other_files_have_every_key(name: str) -> None:
    """A copy over params.yaml must not lose a knob."""
    own, other = (yaml.safe_load((ROOT / path).read_text()) for path in ("params.yaml", name))
    assert list(own) == list(other)
    for section in own:
        if section not in ("graphs", "models"):
            assert list(own[section]) == list(other[section])


def test_table2_shares_the_samples_artefacts() -> None:
    own, table2 = (yaml.safe_load((ROOT / path).read_text()) for path in ("params.yaml", "params.table2.yaml"))
    assert {key for key in own if own[key] != table2[key]} == {"models", "train"}
    assert {**PAPER, "sa-gnn-ncp-unpruned": None}.keys() == table2["models"].keys()


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        ("models.sa-gnn-ncp.input", "semantc", "is no variant of graphs: did you mean semantic?"),
        ("models.sa-gnn-ncp.spatial", "cnnn", "spatial"),
        ("models.sa-gnn-ncp.temporal", "gru", "temporal"),
        ("models.sa-gnn-ncp.cell", "cfcc", "cell: 'cfcc' is no network of this project: choose ltc | eq4 | cfc"),
        ("models.sa-gnn-ncp.semantics", 1.5, "models.sa-gnn-ncp.semantics = 1.5"),
        ("models.sa-gnn-ncp.window", 0, "models.sa-gnn-ncp.window = 0"),
        ("graphs.semantic.keep_inter_class", 2, "graphs.semantic.keep_inter_class = 2"),
        ("models.sa-gnn-ncp.input", "image", "gnn eats kNN graphs, and input: image holds images"),
        ("models.sa-gnn-ncp.input", "lidar-pointnet2", "gnn eats kNN graphs"),
        ("models.sa-gnn-ncp.spatial", "cnn", "cnn eats images (a variant with cloud: none), and input: semantic holds"),
        ("models.sa-gnn-ncp.spatial", "pointnet2", "pointnet2 eats points with neighbourhood: pointnet2"),
        ("graphs.lidar.crop_m", [9, 0, -9, 40], "needs left < right and near < far"),
        ("graphs.image.crop_m", [-9, 0, 9, 40], "crop_m says nothing to a variant without a cloud"),
        ("graphs.semantic.kk", 2, "unknown key graphs.semantic.kk"),
        (
            "models.sa-gnn-ncp.wiring",
            {"comand": 5},
            "unknown key models.sa-gnn-ncp.wiring.comand: did you mean command?",
        ),
        ("models.sa-gnn-ncp.wiring", {"motor_fanin": 7}, "motor_fanin = 7, but there are command = 6 neurons"),
        ("encoder.backbone", "smal", "encoder.backbone = 'smal'"),
        ("encoder.backbone", "precomputed", "encoder: backbone: precomputed reads DRIVE/depth/"),
        ("encoder", {**PRECOMPUTED, "weights": {"backbone": "made"}}, "name the folder in weights"),
        ("encoder", {**PRECOMPUTED, "weights": "nowhere"}, "encoder.weights: nowhere holds no PNG files"),
        ("encoder.weights", "nowhere.pt", "encoder.weights: nowhere.pt is missing"),
        ("encoder.teacher", {"backbone": "precomputed", "weights": "made"}, "is no network and cannot teach"),
        (
            "encoder.teacher",
            {"backbone": "small", "weights": None},
            "encoder.teacher: weights: null would teach",
        ),
        (
            "encoder.teacher",
            {"backbone": "small", "weights": {"backbone": "nowhere.pth"}},
            "encoder.teacher.weights.backbone: nowhere.pth is missing",
        ),
        (
            "encoder.teacher",
            {"backbone": "small", "weights": "a.pt", "weigths": "b.pt"},
            "unknown key encoder.teacher.weigths: did you mean weights?",
        ),
        ("train.epochs", "many", "train.epochs = 'many'"),
        ("train.seeds", [0, 0], "a seed is named twice"),
        ("evaluate.seed", None, "evaluate.seed"),
    ],
)
def test_faults_are_found_wherever_they_are(tmp_path: Path, where: str, value: Any, message: str) -> None:
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    *path, key = where.split(".")
    section = content
    for part in path:
        section = section[part]
    section[key] = value
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(InputError) as caught:
        check.main(tmp_path / "params.yaml")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
