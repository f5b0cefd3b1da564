import csv
import hashlib
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
import yaml

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.encoder import perceive
from stages.encoder import main
from tests import street
from tests.kitti_drive import write_png

TRAIN, VAL, TEST = "2026_01_01_drive_0001", "2026_01_02_drive_0001", "2026_01_03_drive_0001"
FIT = {"epochs": 2, "frames": 6, "batch": 3, "learning_rate": 0.003, "seed": 0}
SETTINGS = {"backbone": "small", "weights": None, **FIT}


@pytest.fixture
def ingest(tmp_path: Path) -> Path:
    """A training drive, and validation and test drives that nobody can open."""
    folder = tmp_path / "ingest"
    street.write_drive(folder, TRAIN, 9)
    for poisoned in (VAL, TEST):
        (folder / f"{poisoned}.h5").write_bytes(b"poison")
    store.write_index(folder, {TRAIN: "train", VAL: "val", TEST: "test"})
    return folder


def run(ingest: Path, name: str = "encoder", **settings: object) -> Path:
    params = ingest.parent / "params.yaml"
    params.write_text(yaml.safe_dump({"encoder": {**SETTINGS, **settings}}))
    out = main(ingest, ingest.parent / name, params)
    assert out == ingest.parent / name
    return out


def test_fits_on_training_drives_alone_and_writes_what_it_did(ingest: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = run(ingest)
    config = json.loads((out / "config.json").read_text())
    assert config["frames_per_drive"] == {TRAIN: 6}
    assert config["image_size"] == list(street.SIZE)
    assert config["weights"] is None
    assert config["parameters"] > 1000
    rows = list(csv.DictReader((out / "curve.csv").read_text().splitlines()))
    assert [row["epoch"] for row in rows] == ["1", "2"]
    assert float(rows[-1]["loss"]) == pytest.approx(config["losses"]["loss"], rel=1e-4)
    printed = capsys.readouterr().out
    assert "epoch 2/2: loss" in printed
    assert "fitted on 6 frames of 1 drives" in printed
    assert "depth_head by dense depth, class_head by class truth" in printed
    assert not (ingest.parent / ".resume" / "encoder").exists()


def test_same_input_gives_the_same_bytes(ingest: Path) -> None:
    first = run(ingest, epochs=1)
    second = run(ingest, "again", epochs=1)
    (ingest / f"{TEST}.h5").write_bytes(b"another poison")
    third = run(ingest, "other_test_drive", epochs=1)
    digests = {hashlib.sha256((out / "encoder.pt").read_bytes()).hexdigest() for out in (first, second, third)}
    assert len(digests) == 1


def test_weights_are_used_as_they_are_with_no_epochs(ingest: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fitted = run(ingest, epochs=1) / "encoder.pt"
    sha256 = hashlib.sha256(fitted.read_bytes()).hexdigest()
    out = run(ingest, "taken", epochs=0, weights=f"{fitted}#sha256={sha256}", seed=5)
    assert (out / "encoder.pt").read_bytes() == fitted.read_bytes()
    config = json.loads((out / "config.json").read_text())
    assert config["losses"] is None
    assert config["sources"] == [{"part": "all", "path": str(fitted), "sha256": sha256}]
    assert "weights used as they are" in capsys.readouterr().out


def test_weights_are_where_fitting_starts(ingest: Path) -> None:
    fitted = run(ingest, epochs=4)
    more = run(ingest, "more", epochs=1, weights=str(fitted / "encoder.pt"), learning_rate=1e-9)
    first = float((fitted / "curve.csv").read_text().splitlines()[1].split(",")[1])
    assert json.loads((more / "config.json").read_text())["losses"]["loss"] < 0.8 * first


def test_a_drive_with_lidar_alone_teaches_depth(ingest: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = run(ingest, "start", epochs=1)
    street.write_drive(ingest, TRAIN, 9, dense=False, lidar=True)
    fitted = run(ingest, weights=str(start / "encoder.pt"))
    losses = json.loads((fitted / "config.json").read_text())["losses"]
    assert losses["depth"] > 0
    assert losses["classes"] == 0
    assert "class_head is not fitted" in capsys.readouterr().out

    frozen = run(ingest, "frozen", weights=str(fitted / "encoder.pt"), frozen=True)
    assert "is not fitted" not in capsys.readouterr().out
    before, after = (perceive.read(out / "encoder.pt").state for out in (fitted, frozen))
    changed = {name.split(".")[0] for name in before if not torch.allclose(before[name], after[name], atol=1e-5)}
    assert changed == {"depth_head"}  # not even weight decay moves the class head


def test_classes_that_nothing_gives_are_refused(ingest: Path, tmp_path: Path) -> None:
    street.write_drive(ingest, TRAIN, 9, dense=False, lidar=True)
    torch.save(UnifiedEncoder("small").class_head.state_dict(), tmp_path / "head.pth")
    lacking: list[tuple[str, dict[str, object]]] = [
        ("class_head", {}),
        ("backbone", {"weights": {"class_head": str(tmp_path / "head.pth")}}),
        ("backbone", {"backbone": "espnetv2-s1"}),  # its classes are the backbone's
    ]
    for part, settings in lacking:
        with pytest.raises(InputError, match=f"class truth.* no {part}.*teacher"):
            run(ingest, **settings)
    assert not (ingest.parent / "encoder").exists()


def test_depth_that_nothing_gives_is_refused_unless_it_needs_no_fitting(ingest: Path) -> None:
    start = run(ingest, "start", epochs=1)
    with h5py.File(ingest / f"{TRAIN}.h5", "r+") as file:
        file["has_depth"][:] = 0
    with pytest.raises(InputError, match=r"depth or LiDAR.* no depth_head"):
        run(ingest)
    kept = run(ingest, "kept", weights=str(start / "encoder.pt"))
    before, after = (perceive.read(out / "encoder.pt").state for out in (start, kept))
    heads = [name for name in before if name.startswith("depth_head")]
    assert all(torch.equal(before[name], after[name]) for name in heads)
    assert not torch.equal(before["backbone.down1.0.weight"], after["backbone.down1.0.weight"])
    flat = perceive.read(run(ingest, "flat", backbone="espnetv2-s1", epochs=1) / "encoder.pt").state
    assert not flat["depth_head.ground.layers.3.weight"].any()  # flat ground: no correction


def test_nothing_is_written_and_one_line_said_about_a_bad_setting(ingest: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.pt").write_bytes(b"no checkpoint")
    bad = {
        r"encoder: epochs: 0 uses weights as they are": {"epochs": 0},
        r"encoder: frozen: true keeps a backbone": {"frozen": True},
        r"encoder.backbone: there is no backbone 'large': known: .*small": {"backbone": "large"},
        r"encoder\.weights: name a checkpoint, or a published file": {"weights": {"head": "a.pth"}},
        r"teacher.backbone: there is no backbone 'large'": {"teacher": {"backbone": "large", "weights": "a.pt"}},
        r"encoder.teacher: weights: null would teach random classes": {
            "teacher": {"backbone": "espnetv2-s1", "weights": None}
        },
        r"encoder.teacher.weights names no class_head": {
            "teacher": {"backbone": "small", "weights": {"backbone": "a.pth"}}
        },
        r"encoder.teacher.weights names no backbone": {
            "teacher": {"backbone": "small", "weights": {"class_head": "a.pth"}}
        },
        r"precomputed is not a network": {"teacher": {"backbone": "precomputed", "weights": "made"}},
        r"encoder: backbone: precomputed reads DRIVE.*name the folder in weights": {"backbone": "precomputed"},
        r"nowhere\.pt is missing": {"weights": "nowhere.pt"},
        r"has the SHA-256": {"weights": f"{tmp_path / 'bad.pt'}#sha256={'1' * 64}"},
        r"bad\.pt is cut short": {"weights": str(tmp_path / "bad.pt")},
        r"unknown key encoder\.epoch:.*epochs": {"epoch": 3},
    }
    for message, settings in bad.items():
        with pytest.raises(InputError, match=message) as caught:
            run(ingest, **settings)
        assert "\n" not in str(caught.value)
    assert not (ingest.parent / "encoder").exists()


def test_weights_of_another_backbone_are_refused(ingest: Path, tmp_path: Path) -> None:
    perceive.save(tmp_path / "other", "swin-t", {})
    with pytest.raises(InputError, match=r"holds backbone 'swin-t', expected 'small'"):
        run(ingest, weights=str(tmp_path / "other/encoder.pt"))


def espnet(tmp_path: Path) -> tuple[str, dict[str, torch.Tensor]]:
    """A file like a published ESPNetv2, of noise that sees many classes."""
    torch.manual_seed(3)
    state = UnifiedEncoder("espnetv2-s1").backbone.state_dict()
    state["bu_dec_l4.merge_layer.3.weight"] *= 30
    torch.save(state, tmp_path / "city.pth")
    return str(tmp_path / "city.pth"), state


def test_a_published_backbone_stays_and_its_depth_head_is_fitted(ingest: Path, tmp_path: Path) -> None:
    street.write_drive(ingest, TRAIN, 9, dense=False, lidar=True)
    file, state = espnet(tmp_path)
    out = run(ingest, backbone="espnetv2-s1", weights={"backbone": file}, frozen=True)
    fitted = perceive.read(out / "encoder.pt").state
    assert all(torch.equal(fitted[f"backbone.{name}"], tensor) for name, tensor in state.items())
    assert fitted["depth_head.ground.layers.3.weight"].any()  # it starts at zero
    sources = json.loads((out / "config.json").read_text())["sources"]
    assert [(source["part"], source["path"]) for source in sources] == [("backbone", file)]
    with pytest.raises(InputError, match="no depth_head"):
        run(ingest, "unfitted", backbone="espnetv2-s1", weights={"backbone": file}, epochs=0)


def test_a_teacher_gives_classes_to_frames_without(ingest: Path, tmp_path: Path) -> None:
    street.write_drive(ingest, TRAIN, 9, dense=False, lidar=True)
    teacher = {"backbone": "espnetv2-s1", "weights": {"backbone": espnet(tmp_path)[0]}}
    out = run(ingest, teacher=teacher, epochs=3)
    rows = list(csv.DictReader((out / "curve.csv").read_text().splitlines()))
    assert 0 < float(rows[-1]["classes"]) < float(rows[0]["classes"])


def test_a_teacher_may_see_images_of_all_drives_and_nothing_else_of_them(ingest: Path, tmp_path: Path) -> None:
    teacher = {"backbone": "espnetv2-s1", "weights": {"backbone": espnet(tmp_path)[0]}, "drives": "all"}
    digests = set()
    for name, known in {
        "blind": {"dense": False},
        "dense": {"dense": True},
        "lidar": {"dense": False, "lidar": True},
    }.items():
        for drive in (VAL, TEST):
            street.write_drive(ingest, drive, 4, **known)
        out = run(ingest, name, teacher=teacher, epochs=1, frames=12)
        frames = json.loads((out / "config.json").read_text())["frames_per_drive"]
        assert all(frames[drive] > 0 for drive in (TRAIN, VAL, TEST))
        digests.add(hashlib.sha256((out / "encoder.pt").read_bytes()).hexdigest())
    assert len(digests) == 1


def test_a_folder_of_precomputed_files_is_noted(ingest: Path, tmp_path: Path) -> None:
    settings = {"backbone": "precomputed", "weights": str(tmp_path / "made"), "epochs": 0}
    with pytest.raises(InputError, match="holds no PNG files"):
        run(ingest, **settings)
    noted = []
    for frame in range(2):
        write_png(tmp_path / "made" / TRAIN / "cls" / f"{frame:010d}.png", np.zeros((4, 4), np.uint8))
        noted.append(json.loads((run(ingest, **settings) / "config.json").read_text()))
    assert [config["files"] for config in noted] == [1, 2]
    assert noted[0]["fingerprint"] != noted[1]["fingerprint"]
