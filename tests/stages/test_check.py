import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.base import provenance
from pipeline.base.errors import InputError
from pipeline.encoder import download, weights
from pipeline.report.tables import paper
from pipeline.report.tables.paper import PAPER
from pipeline.sections import preset
from pipeline.sections.models import Model, resolve
from stages import check

ROOT = Path(__file__).resolve().parents[2]
FIT = {"epochs": 1, "frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}
PRECOMPUTED = {"backbone": "precomputed", **FIT}


@pytest.mark.parametrize("name", [None, *sorted(path.stem for path in preset.PRESETS.glob("*.yaml"))])
def test_the_projects_own_files_are_right(name: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the weights lie that nothing fetches; none is read, none fetched."""

    def never(*_: object) -> None:
        raise AssertionError("check reads or fetches weights")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(weights, "find", never)
    monkeypatch.setattr(download, "download", never)
    (tmp_path / "weights").mkdir()
    params = tmp_path / "params.yaml"
    params.write_text(preset.text(name) if name else (ROOT / "params.yaml").read_text())
    encoder = yaml.safe_load(params.read_text())["encoder"]
    for file in weights.files(encoder["weights"], "encoder.weights").values():
        if "sha256=" not in file:
            (tmp_path / "weights" / file.rsplit("/", 1)[-1]).touch()
    assert check.main(params) == params


def test_weights_that_nothing_will_fetch_are_missed_before_ingest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text(preset.text("kitti"))
    with pytest.raises(InputError) as checked:
        check.main(tmp_path / "params.yaml")
    key = "encoder.weights.depth_head"
    with pytest.raises(InputError, match=rf"^{key}: weights/.*head\.pth is missing.*: curl ") as found:
        weights.find(preset.merged("kitti")["encoder"]["weights"]["depth_head"], key)
    assert str(checked.value).endswith(str(found.value))


def test_table2_shares_the_samples_artefacts() -> None:
    own, table2 = yaml.safe_load((ROOT / "params.yaml").read_text()), preset.merged("table2")
    assert {key for key in own if own[key] != table2[key]} == {"graphs", "models", "train"}
    assert own["graphs"].items() <= table2["graphs"].items()  # one is added
    assert own["models"].items() <= table2["models"].items()


def test_table2_has_the_papers_networks_as_the_paper_has_them() -> None:
    models = preset.merged("table2")["models"]
    for name in PAPER:
        line = load_model(models[name])
        assert (
            paper.name(line | ({"width": 1.0} if "width" in line else {})) == name
        )  # narrower, as the sample is small
    others = [load_model(line) for name, line in models.items() if name not in PAPER]
    assert others
    assert not any(map(paper.name, others))


def load_model(line: dict[str, Any]) -> dict[str, Any]:
    """Return a model's entry with all defaults."""
    return resolve(Model.model_validate(line))


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        ("models.sa-gnn-ncp.input", "semantc", "models.sa-gnn-ncp.input = 'semantc' .* did you mean semantic"),
        ("models.sa-gnn-ncp.spatial", "cnnn", "models.sa-gnn-ncp.spatial = 'cnnn'.*known: blind, cnn"),
        ("models.sa-gnn-ncp.temporal", "gru", "models.sa-gnn-ncp.temporal = 'gru'.*lstm, ncp"),
        ("models.sa-gnn-ncp.cell", "cfcc", "models.sa-gnn-ncp.cell = 'cfcc'.*'ltc', 'eq4' or 'cfc'"),
        ("models.sa-gnn-ncp.semantics", 1.5, "models.sa-gnn-ncp.semantics = 1.5: "),
        (
            "models.sa-gnn-ncp.width",
            0.25,
            "models.sa-gnn-ncp.width: unknown key for .*gnn.*ncp.*layers, semantics",
        ),
        ("models.sa-gnn-ncp.motion", "lidar", "models.sa-gnn-ncp.motion = 'lidar' .*motion.kinds has visual"),
        ("graphs.lidar.accumulate", {"motion": "lidar", "frames": 2}, "lidar.accumulate.motion = 'lidar' is not"),
        ("models.sa-gnn-ncp.motion", "gps", "models.sa-gnn-ncp.motion = 'gps'"),
        ("models.sa-gnn-ncp.horizon", -1, "models.sa-gnn-ncp.horizon = -1"),
        ("models.sa-gnn-ncp.roads", 1000, r"models.sa-gnn-ncp.roads = 1000, but there are \d+ training drives"),
        ("models.sa-gnn-ncp.equivarient", True, "models.sa-gnn-ncp.equivarient .*did you mean equivariant"),
        ("models.sa-gnn-ncp.window", 0, "models.sa-gnn-ncp.window = 0"),
        ("graphs.semantic.keep_inter_class", 2, "graphs.semantic.keep_inter_class = 2"),
        ("models.sa-gnn-ncp.input", "image", "spatial = 'gnn' expects kNN graphs.* input: image holds images"),
        ("models.sa-gnn-ncp.input", "lidar-pointnet2", "spatial = 'gnn' expects kNN graphs"),
        ("models.sa-gnn-ncp.spatial", "cnn", "spatial = 'cnn' expects images, but input: semantic holds kNN"),
        ("models.sa-gnn-ncp.spatial", "pointnet2", "spatial = 'pointnet2' expects points .* holds kNN graphs"),
        ("graphs.lidar.crop_m", [9, 0, -9, 40], "needs left < right and near < far"),
        ("graphs.image.crop_m", [-9, 0, 9, 40], "crop_m means nothing to images"),
        ("graphs.semantic.kk", 2, "unknown key graphs.semantic.kk"),
        ("models.sa-gnn-ncp.wiring", {"comand": 5}, "models.sa-gnn-ncp.wiring.comand.*did you mean command"),
        (
            "models.sa-gnn-ncp.wiring",
            {"motor_fanin": 7},
            "models.sa-gnn-ncp.wiring.motor_fanin = 7, expected at most command = 6",
        ),
        ("encoder.backbone", "smal", "encoder.backbone = 'smal': .*did you mean small"),
        ("encoder.backbone", "precomputed", "encoder: backbone: precomputed reads DRIVE/depth/"),
        ("encoder", {**PRECOMPUTED, "weights": {"backbone": "made"}}, "name the folder in weights"),
        ("encoder", {**PRECOMPUTED, "weights": "nowhere"}, "encoder.weights: nowhere holds no PNG files"),
        ("encoder.weights", "nowhere.pt", "encoder.weights: nowhere.pt is missing"),
        ("encoder.teacher", {"backbone": "precomputed", "weights": "made"}, "is not a network"),
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
    assert re.search(message, str(caught.value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("motion", "source", "message"),
    [
        (["visual", "lidar"], "clouds/pseudo", "motion.kinds: lidar is measured from scans, and ingest.lidar: false"),
        (["visual"], "clouds/lidar", "models.sa-gnn-ncp.input = 'semantic' is made of scans, and ingest.lidar: false"),
    ],
)
def test_nothing_is_made_of_scans_that_are_not_read(
    tmp_path: Path, motion: list[str], source: str, message: str
) -> None:
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    content["ingest"]["lidar"], content["motion"]["kinds"] = False, motion
    content["graphs"]["semantic"]["source"] = source
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=message):
        check.main(tmp_path / "params.yaml")


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("from models.steering.spatial.gatv2 import HEADS", "models/steering/spatial/gatv2.py"),
        ("from models.steering.core.own import thing", "models/steering/spatial/gatv2.py"),
        ("import models.encoder.heads", "models/encoder/heads.py"),
        ("from pipeline.base import params", "pipeline/base/params.py"),
        ("from models.steering.core.cell import ltc", None),
        ("from pipeline.camera import classes", None),
    ],
)
def test_a_network_imports_only_what_dvc_watches_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, found: str | None
) -> None:
    """Its file lies in a copy of the project that is read, and beside this one's networks, where it is imported."""
    from models.steering import core, spatial

    for room in ("models", "pipeline"):
        shutil.copytree(ROOT / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    monkeypatch.setattr(spatial, "__path__", [*spatial.__path__, str(tmp_path / "models/steering/spatial")])
    monkeypatch.setattr(core, "__path__", [*core.__path__, str(tmp_path / "models/steering/core")])
    own = tmp_path / "models/steering/spatial/own.py"
    own.write_text(f"{line}\n" + (ROOT / "models/steering/spatial/gnn.py").read_text())
    (tmp_path / "models/steering/core/own.py").write_text("from models.steering.spatial.gatv2 import HEADS as thing\n")
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    content["models"]["sa-gnn-ncp"]["spatial"] = "own"
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(content))
    try:
        if found is None:
            check.main(tmp_path / "params.yaml")
        else:
            with pytest.raises(
                InputError, match=rf"spatial = 'own': {own.relative_to(tmp_path)} .*{found}.*steering/core"
            ):
                check.main(tmp_path / "params.yaml")
    finally:
        for package in (spatial, core):
            sys.modules.pop(f"{package.__name__}.own", None)
            vars(package).pop("own", None)
