"""steer measure: known motion of a rendered street, and input that shows no motion of a car."""

import csv
import json
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from models.encoder.backbones import Backbone, Part, Parts
from models.encoder.unified_encoder import BACKBONES, UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.mount import CAMERA_HEIGHT_M
from pipeline.live import results
from pipeline.perception.perceive import save
from steer.measure import measure
from tests import rendered_street as street
from tests.footage import write_folder
from tests.kitti_drive import write

YAW_RATE, SPEED = 0.2, 8.0
LENS = {"k": "180,180,159.5,44", "fps": 10.0, "camera_height": CAMERA_HEIGHT_M}


class Features(Backbone):
    """Passes the image on. The encoder's runner needs a parameter to find the device."""

    mean, std = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)

    def __init__(self) -> None:
        super().__init__()
        self.unused = nn.Parameter(torch.zeros(1))

    def forward(self, image: Tensor, rays: Tensor) -> Tensor:
        return image


class FlatGround(Part):
    """A depth head that predicts flat ground, and houses 30 m away."""

    down = 1  # axis of the camera

    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        return (CAMERA_HEIGHT_M / rays[:, self.down].clamp(min=1e-3)).clamp(max=30)


class Void(Part):
    def forward(self, features: Tensor, rays: Tensor) -> Tensor:
        logits = torch.zeros(len(rays), classes.COUNT + 1, *rays.shape[-2:])
        logits[:, -1] = 1
        return logits


@pytest.fixture
def encoder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    parts = Parts(Features(), FlatGround(), Void())
    monkeypatch.setitem(BACKBONES, "flat ground", lambda: parts)
    save(tmp_path / "encoder", "flat ground", UnifiedEncoder("flat ground").state_dict())
    return tmp_path / "encoder"


def drive(count: int, start: int = 0) -> list[np.ndarray]:
    return [street.view(pose)[0] for pose in street.arc(start + count, YAW_RATE, SPEED)[start:]]


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "motion.csv").open() as file:
        return list(csv.DictReader(file))


def column(out: Path, name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows(out)])


def test_known_motion_is_measured_and_drawn(tmp_path: Path, encoder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, images, log = tmp_path / "out", write_folder(tmp_path / "images", drive(30)), tmp_path / "can.csv"
    log.write_text(f"time_s,speed_mps,yaw_rate_radps\n0,{SPEED / 1.2},{YAW_RATE}\n2,{SPEED / 1.2},{YAW_RATE}\n")
    logs = {"motion": log, "poses": "kitti", "distortion": "0,0,0,0"}
    measure(images, out=out, encoder=encoder, as_json=True, **logs, **LENS)
    result = json.loads(capsys.readouterr().out)
    assert (result["frames"], result["valid"]) == (30, 29)
    assert column(out, "valid").tolist() == [0] + 29 * [1]
    assert column(out, "yaw_rate_radps")[1:] == pytest.approx(YAW_RATE, abs=0.02)
    assert column(out, "speed_mps")[1:] == pytest.approx(SPEED, rel=0.1)
    angle = np.arctan(2.7 * YAW_RATE / SPEED)
    assert column(out, "measured_rad")[1:] == pytest.approx(angle, abs=0.01)
    assert column(out, "heading_rad")[-1] == pytest.approx(2.9 * YAW_RATE, rel=0.1)
    assert column(out, "y_m")[-1] == pytest.approx(SPEED / YAW_RATE * (1 - np.cos(2.9 * YAW_RATE)), rel=0.2)  # left
    quality = json.loads((out / "quality.json").read_text())
    assert quality["road_height_m"] == pytest.approx(CAMERA_HEIGHT_M, rel=0.1)
    assert any("camera's height of 1.65 m" in remark for remark in quality["remarks"])
    assert (quality["K"][0][0], quality["distortion"]) == (180, "0,0,0,0")
    assert quality["speed_ratio"] == pytest.approx(1.2, rel=0.1)
    assert any("times the one recorded in can.csv" in remark for remark in quality["remarks"])
    assert result["comparison"]["frames"] == 20  # to the end of the log at 2 s
    assert quality["speed_sigma"] < 0.1
    assert len((out / "poses.txt").read_text().splitlines()) == 30
    assert (out / "track.png").read_bytes().startswith(b"\x89PNG")
    with av.open(str(out / "overlay.mp4")) as file:
        assert sum(1 for _ in file.decode(video=0)) == 30


def test_a_drive_is_compared_with_its_recorded_angles(
    tmp_path: Path, encoder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "2026_01_01/2026_01_01_drive_0001_sync"
    write_folder(folder / "image_02/data", drive(20), "{:010d}.png")
    times = "".join(f"2026-01-01 12:00:{row / 10:012.9f}\n" for row in range(20))
    write(folder / "image_02/timestamps.txt", times)
    rectified = "R_rect_00: 1 0 0 0 1 0 0 0 1\nS_rect_02: 320 96\nP_rect_02: 180 0 159.5 0 0 180 44 0 0 0 1 0\n"
    write(folder.parent / "calib_cam_to_cam.txt", rectified)
    angle = np.arctan(2.7 * YAW_RATE / SPEED)
    write(folder / "steering.csv", "frame,steering_rad\n" + "".join(f"{row},{angle}\n" for row in range(5, 25)))
    measure(folder, out=tmp_path / "out", encoder=encoder, video=False, as_json=True)
    comparison = json.loads(capsys.readouterr().out)["comparison"]
    assert (comparison["truth"], comparison["frames"]) == ("steering.csv", 15)
    assert comparison["measured"]["rmse_deg"] < 0.6
    assert comparison["measured"]["correlation"] is None  # the true angle is constant
    assert comparison["zero"]["rmse_deg"] == pytest.approx(np.rad2deg(angle))
    measure(folder, out=tmp_path / "out", encoder=encoder, video=False)
    text = capsys.readouterr().out
    assert "truth from steering.csv, 15 frames:\n  measured: nmse 0.0" in text
    (folder / "steering.csv").unlink()
    with_truth = (tmp_path / "out/track.png").read_bytes()
    measure(folder, out=tmp_path / "out", encoder=encoder, video=False)
    assert "truth from" not in capsys.readouterr().out
    assert (tmp_path / "out/track.png").read_bytes() != with_truth


def noisy(image: np.ndarray, count: int) -> list[np.ndarray]:
    """Return a still image with the noise of a camera."""
    rng = np.random.default_rng(0)
    return [np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8) for _ in range(count)]


GREY, NIGHT = np.full((*street.SIZE, 3), 90, np.uint8), np.full((*street.SIZE, 3), 3, np.uint8)


@pytest.mark.parametrize("kind", ["standing", "without texture", "night", "snow"])
def test_input_without_motion_gets_no_numbers(
    tmp_path: Path, encoder: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    stills = {"standing": drive(1)[0], "without texture": GREY, "night": NIGHT}
    snow = np.random.default_rng(1).integers(0, 255, (12, *street.SIZE, 3), np.uint8)
    images = write_folder(tmp_path / "images", noisy(stills[kind], 12) if kind in stills else snow)
    measure(images, out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    for row in rows(tmp_path / "out"):
        assert row["valid"] == "0"
        assert not any(row[name] for name in ("speed_mps", "yaw_rate_radps", "measured_rad", "x_m", "points"))
    text = capsys.readouterr().out
    assert "motion measured in 0 of 12 frames; not measured:" in text
    assert "horizon: not found" in text


def test_a_cut_is_not_a_motion(tmp_path: Path, encoder: Path) -> None:
    before = [image[:, ::-1] for image in drive(10)]
    images = write_folder(tmp_path / "images", [*before, *drive(10, start=25)])
    measure(images, out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    valid, yaw_rate = column(tmp_path / "out", "valid"), column(tmp_path / "out", "yaw_rate_radps")
    assert valid.tolist() == [0, *9 * [1], 0, *9 * [1]]
    assert yaw_rate[1:6] == pytest.approx(-YAW_RATE, abs=0.02)  # mirrored
    assert yaw_rate[15:] == pytest.approx(YAW_RATE, abs=0.02)


def test_a_camera_on_its_side_is_refused(tmp_path: Path, encoder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FlatGround, "down", 0)
    roll = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    views = [street.view(pose @ roll)[0] for pose in street.arc(30, YAW_RATE, SPEED)]
    with pytest.raises(InputError, match=r"pitch changes by 2\d degrees") as raised:
        measure(write_folder(tmp_path / "images", views), out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    assert "transpose" in raised.value.fix
    assert not (tmp_path / "out/motion.csv").exists()


def test_missing_and_unsuitable_inputs_are_named(
    tmp_path: Path, encoder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "LINE_S", 0.0)
    images = write_folder(tmp_path / "images", drive(4))
    with pytest.raises(InputError, match="no encoder") as raised:
        measure(images, out=tmp_path / "out", encoder=tmp_path, **LENS)
    assert "make street" in raised.value.fix
    rotated = write_folder(tmp_path / "rotated", [np.rot90(image) for image in drive(4)])
    with pytest.raises(InputError, match="taller than wide"):
        measure(rotated, out=tmp_path / "out", encoder=encoder, fov=80.0)
    assert not (tmp_path / "out").exists()
    measure(images, out=tmp_path / "out", encoder=encoder, fov=80.0, max_frames=3, video=False)
    assert len(rows(tmp_path / "out")) == 3
    text, progress = capsys.readouterr()
    assert "3 of 3 frames, " in progress
    assert "latency" not in progress  # a measurement predicts nothing
    assert "assuming 10 per second" in text
    assert "pass --camera-height" in text or "typical car" in text
