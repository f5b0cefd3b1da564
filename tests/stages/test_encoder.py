import csv
import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base import store
from pipeline.base.resume import ROOT
from pipeline.perception import perceive
from pipeline.settings import preset
from stages.encoder import main
from tests import street

TRAIN, VAL, TEST = "2026_01_01_drive_0001", "2026_01_02_drive_0001", "2026_01_03_drive_0001"
SETTINGS = {
    "backbone": "small", "weights": None, "epochs": 1, "frames": 6, "batch": 3, "learning_rate": 0.003, "seed": 0,
}  # fmt: skip


def write_ingest(folder: Path, **kinds: bool) -> None:
    """Write a training drive, and validation and test drives that cannot be opened."""
    street.write_drive(folder, TRAIN, 6, **kinds)
    for name in (VAL, TEST):
        (folder / f"{name}.h5").write_bytes(b"not HDF5")
    store.write_index(folder, {TRAIN: "train", VAL: "val", TEST: "test"})


@pytest.fixture
def ingest(tmp_path: Path) -> Path:
    write_ingest(tmp_path / "ingest")
    return tmp_path / "ingest"


@pytest.fixture
def lidar(tmp_path: Path) -> Path:
    """The training drive has LiDAR and no labels."""
    write_ingest(tmp_path / "ingest", dense=False, lidar=True)
    return tmp_path / "ingest"


def run(ingest: Path, name: str = "encoder", **settings: object) -> Path:
    params = ingest.parent / "params.yaml"
    params.write_text(yaml.safe_dump({"encoder": {**SETTINGS, **settings}}))
    out = main(ingest, ingest.parent / name, params)
    assert out == ingest.parent / name
    return out


def config(out: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((out / "config.json").read_text())
    return content


def curve(out: Path) -> list[dict[str, float]]:
    rows = csv.DictReader((out / "curve.csv").read_text().splitlines())
    return [{key: float(value) for key, value in row.items()} for row in rows]


def state(out: Path) -> dict[str, torch.Tensor]:
    return dict(perceive.read(out / "encoder.pt")[1])


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The output of a fit to dense labels."""
    folder = tmp_path_factory.mktemp("fitted")
    write_ingest(folder / "ingest")
    return run(folder / "ingest", epochs=3)


@pytest.fixture(scope="module")
def espnet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A random file like a published ESPNetv2, with many classes in its output."""
    torch.manual_seed(3)
    tensors = UnifiedEncoder("espnetv2-s1").backbone.state_dict()
    tensors["bu_dec_l4.merge_layer.3.weight"] *= 30
    path = tmp_path_factory.mktemp("weights") / "city.pth"
    torch.save(tensors, path)
    return path


def test_the_fit_uses_training_drives_only_and_reports_itself(ingest: Path, fitted: Path) -> None:
    out = run(ingest, epochs=3)
    assert (out / "encoder.pt").read_bytes() == (fitted / "encoder.pt").read_bytes(), "equal input, equal bytes"
    content = config(out)
    assert content["frames_per_drive"] == {TRAIN: 6}
    assert [row["epoch"] for row in curve(out)] == [1, 2, 3]
    assert curve(out)[-1]["loss"] == pytest.approx(content["losses"]["loss"], rel=1e-4)


def test_without_epochs_weights_are_used_as_they_are(ingest: Path, fitted: Path) -> None:
    path = fitted / "encoder.pt"
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    out = run(ingest, epochs=0, weights={"url": str(path), "sha256": sha256}, seed=5)
    assert (out / "encoder.pt").read_bytes() == path.read_bytes()
    assert config(out)["losses"] is None
    assert config(out)["sources"] == [{"part": "all", "path": str(path), "sha256": sha256}]


def test_a_fit_starts_from_weights_and_from_lidar_alone_fits_depth_only(lidar: Path, fitted: Path) -> None:
    weights = str(fitted / "encoder.pt")
    out = run(lidar, weights=weights, frozen=True)
    assert config(out)["losses"]["depth"] > 0
    assert config(out)["losses"]["classes"] == 0
    before, after = state(fitted), state(out)
    changed = {name.split(".")[0] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"depth_head"}  # weight decay does not change the class head either


def test_a_teacher_labels_images_of_all_drives_without_use_of_their_labels(ingest: Path, espnet: Path) -> None:
    teacher = {"backbone": "espnetv2-s1", "weights": {"backbone": str(espnet)}, "drives": "all"}
    digests = set()
    for name, kinds in {"bare": {"dense": False}, "lidar": {"dense": False, "lidar": True}, "dense": {}}.items():
        for drive in (VAL, TEST):
            street.write_drive(ingest, drive, 4, **kinds)
        out = run(ingest, name, teacher=teacher, frames=12)
        assert all(config(out)["frames_per_drive"][drive] > 0 for drive in (TRAIN, VAL, TEST))
        digests.add(hashlib.sha256((out / "encoder.pt").read_bytes()).hexdigest())
    assert len(digests) == 1


def test_the_samples_encoder_is_the_default_and_was_fitted_by_its_preset_on_other_roads(tmp_path: Path) -> None:
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    fitted, shipped = preset.validate(preset.merged("encoder"), tmp_path), ROOT / content["encoder"]["weights"]
    assert shipped.stat().st_size <= 2_500_000
    made = config(shipped.parent)
    assert made.items() >= fitted.encoder.model_dump(mode="json").items()
    assert made["frames_per_drive"].keys() == set(fitted.ingest.drives.train)
    sample = preset.validate(content, tmp_path).ingest.drives
    assert not made["frames_per_drive"].keys() & sample.splits().keys()
    assert {drive[:10] for drive in made["frames_per_drive"]} <= {drive[:10] for drive in sample.train}
    content["encoder"]["weights"] = str(shipped)
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(content))
    out = main(tmp_path / "no-drives", tmp_path / "encoder", tmp_path / "params.yaml")
    assert (out / "encoder.pt").read_bytes() == shipped.read_bytes()
