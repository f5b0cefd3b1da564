"""Stage encoder: the fit, weights as they are, and networks that do not suit the images."""

import json
import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import torch
import yaml

from models.encoder.street import SOURCES
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.encoder import encoder_file
from stages import preset
from stages.encoder import main
from tests import street
from tests.artefacts import write_index
from tests.models.encoder.test_encoders import write_networks

TRAIN = "2026_01_01_drive_0001"
VAL = "2026_01_02_drive_0001"
TEST = "2026_01_03_drive_0001"
SETTINGS = {
    "backbone": "small",
    "weights": None,
    "epochs": 1,
    "frames": 6,
    "batch": 3,
    "learning_rate": 0.003,
    "seed": 0,
}


def write_ingest(folder: Path) -> None:
    """Write a training drive, and validation and test drives that cannot be opened."""
    street.write_drive(folder, TRAIN, 6)
    for name in (VAL, TEST):
        (folder / f"{name}.h5").write_bytes(b"not HDF5")
    write_index(folder, {TRAIN: "train", VAL: "val", TEST: "test"})


def run(ingest: Path, size: tuple[int, int] = street.SIZE, **settings: object) -> Path:
    params = ingest.parent / "params.yaml"
    reading = yaml.safe_load((ROOT / "params.yaml").read_text())["ingest"] | {"image_size": [*size]}
    params.write_text(yaml.safe_dump({"ingest": reading, "encoder": {**SETTINGS, **settings}}))
    return main(ingest.parent, params)


def config(out: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((out / "config.json").read_text())
    return content


def test_the_fit_uses_training_drives_only_and_reports_itself(tmp_path):
    """Equal inputs give equal bytes."""
    for name in "ab":
        write_ingest(tmp_path / name / "ingest")
    other = run(tmp_path / "a/ingest", epochs=2)
    out = run(tmp_path / "b/ingest", epochs=2)
    assert (out / "encoder.pt").read_bytes() == (other / "encoder.pt").read_bytes()
    content = config(out)
    assert content["frames_per_drive"] == {TRAIN: 6}
    architecture, _ = encoder_file.load_encoder(out / "encoder.pt")
    assert architecture == {"backbone": "small", "datasets": ["kitti"]}
    curve = pd.read_csv(out / "curve.csv")
    assert curve["epoch"].tolist() == [1, 2]
    assert all(curve[loss][1] < curve[loss][0] for loss in ("depth", "classes"))
    assert curve["loss"][1] == pytest.approx(content["losses"]["loss"], rel=1e-4)


def test_a_network_that_does_not_take_images_of_ingest_is_one_line_before_any_drive(tmp_path):
    write_networks(tmp_path)
    pair = {
        "backbone": "pair",
        "epochs": 0,
        "depth": str(tmp_path / "depth"),
        "classes": str(tmp_path / "dpt"),
        "focal_by_width": 0.5,
    }
    problems = {(96, 320): "cannot run 'dpt': .+", (64, 256): "'dpt' returns 128 x 128 .*"}
    for size, problem in problems.items():
        where = re.escape(f"params.yaml: backbone pair, ingest.image_size {[*size]}: ")
        with pytest.raises(InputError, match=f"{where}{problem}$"):
            run(tmp_path / "no-drives", size=size, **pair)


@pytest.mark.parametrize(("depth", "count"), [(float("nan"), 19), (-1.0, 19), (0.0, 19), (9.0, 20)])
def test_depth_of_no_pixel_and_another_number_of_classes_are_faults_of_the_network(depth, count):
    model = torch.nn.Linear(1, 1)
    outputs = torch.full((1, 32, 64), depth), torch.zeros(1, count, 32, 64)
    model.forward = lambda image, K: outputs
    message = rf"^depth \(32, 64\) is .*, logits \({count}, 32, 64\)$"
    with pytest.raises(ValueError, match=message):
        encoder_file.check_size(model, (32, 64))


@pytest.mark.real
def test_the_encoder_of_streets_takes_published_files_and_names_their_terms(
    tmp_path, real_weights, monkeypatch
):
    monkeypatch.setattr("pipeline.encoder.create.WEIGHTS", real_weights)
    out = run(tmp_path / "no-drives", backbone="street", epochs=0)
    sources = config(out)["sources"]
    assert [source.split(":")[0] for source in sources] == [*SOURCES]
    assert all("non-commercial" in source for source in sources)
    (tmp_path / "again").mkdir()
    weights = str(out / "encoder.pt")
    again = run(tmp_path / "again/no-drives", backbone="street", epochs=0, weights=weights)
    assert (again / "encoder.pt").read_bytes() == (out / "encoder.pt").read_bytes()
    assert config(again)["sources"] == sources


def test_the_samples_encoder_is_the_default_and_was_fitted_by_its_preset_on_other_roads(tmp_path):
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    fitted = preset.Params.model_validate(preset.merge_preset("encoder"))
    shipped = ROOT / content["encoder"]["weights"]
    assert shipped.stat().st_size <= 2_500_000
    made = config(shipped.parent)
    assert made.items() >= fitted.encoder.model_dump(mode="json", exclude_none=True).items()
    assert made["frames_per_drive"].keys() == set(fitted.ingest.drives.train)
    sample = preset.Params.model_validate(content).ingest.drives
    assert not made["frames_per_drive"].keys() & sample.splits().keys()
    days = {drive[:10] for drive in made["frames_per_drive"]}
    assert days <= {drive[:10] for drive in sample.train}
    content["encoder"]["weights"] = str(shipped)
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(content))
    out = main(tmp_path, tmp_path / "params.yaml")
    assert (out / "encoder.pt").read_bytes() == shipped.read_bytes()
