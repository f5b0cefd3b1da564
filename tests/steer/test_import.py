"""steer import: the stages compute from a recording what its log holds, or the recording is refused."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.kitti.oxts import read_steering, read_times
from pipeline.kitti.raw import MANIFEST, KittiDrive
from pipeline.labels.label import steering_labels
from pipeline.settings import preset
from pipeline.video.import_recording import GAP_S, cut
from stages import check, ingest, labels
from steer.import_ import import_recording
from tests.kitti_drive import contents, write_params
from tests.recordings import SIZE, pictures, write_folder, write_video

DRIVES = ("2027_03_31_drive_0001", "2027_03_31_drive_0002")
FRAMES = 12
TIMES_S = np.arange(FRAMES) / 10 + np.random.default_rng(0).uniform(-0.004, 0.004, FRAMES)
SPEED_MPS, YAW_RATE_RADPS = 6 + np.sin(TIMES_S), 0.3 * np.cos(3 * TIMES_S)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A car's log with a sample at each image."""
    path = tmp_path / "can.csv"
    rows = np.column_stack([TIMES_S, SPEED_MPS, YAW_RATE_RADPS]).tolist()
    path.write_text("time_s,speed_mps,yaw_rate_radps\n" + "".join(f"{t!r},{v!r},{w!r}\n" for t, v, w in rows))
    return path


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "drive.mp4", pictures(FRAMES))


def take(recording: Path, log: Path, drive: str = DRIVES[0], **options: Any) -> KittiDrive:
    """Import with a field of view of 80 degrees into raw/ beside the log."""
    out = log.parent / "raw"
    import_recording(recording, drive, **{"motion": log, "out": out, "fov": 80.0, **options})
    return KittiDrive(out / drive[:10] / f"{drive}_sync")


def written(log: Path) -> dict[str, bytes]:
    """Return the files below raw/."""
    return contents(log.parent / "raw") if (log.parent / "raw").exists() else {}


def test_labels_follow_the_log(tmp_path: Path, log: Path, video: Path) -> None:
    """From an MPEG-4 video and from lossless images, through stages ingest and labels."""
    times = tmp_path / "times.txt"
    times.write_text("".join(f"{time_s!r}\n" for time_s in TIMES_S.tolist()))
    take(video, log, DRIVES[0], times=times)
    take(write_folder(tmp_path / "images", pictures(FRAMES)), log, DRIVES[1], times=times)

    params = write_params(tmp_path / "params.yaml", [DRIVES[0]], [DRIVES[1]], image_size=list(SIZE))
    ingested = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params, workers=1)
    labelled = labels.main(ingest=ingested, out=tmp_path / "data/labels", params=params)
    steering, valid = steering_labels(YAW_RATE_RADPS, SPEED_MPS, wheelbase_m=2.7, min_speed_mps=1.0)
    for drive, lossless in zip(DRIVES, (False, True), strict=True):
        with DriveReader(labelled / f"{drive}.h5", stage="labels") as file:
            np.testing.assert_array_equal(file.frame, np.arange(FRAMES))
            np.testing.assert_allclose(file.time_s, TIMES_S - TIMES_S[0], atol=1e-6)
            np.testing.assert_allclose(file["steering_rad"], steering, atol=1e-6)
            np.testing.assert_array_equal(file["valid"], valid)
        with DriveReader(ingested / f"{drive}.h5", stage="ingest") as file:
            error = np.abs(file["image"].astype(float) - pictures(FRAMES))
            assert error.mean() < (1e-9 if lossless else 4)
            assert file["K"][0, 2] == 31.5
            assert "T_cam_velo" not in file


def test_angles_of_the_wheel_are_interpolated_or_by_frame(tmp_path: Path, video: Path) -> None:
    log = tmp_path / "wheel.csv"
    for text, expected in (
        ("time_s,wheel_rad\n0.05,1.0\n0.65,-2.0\n", {n: 0.1 - 0.3 * (n / 10 - 0.05) / 0.6 for n in range(1, 7)}),
        ("frame;wheel_rad\n4;1.5\n11;3.0\n", {4: 0.15, 11: 0.3}),
    ):
        log.write_text(text)
        drive = take(video, log, motion=None, wheel=log, steering_ratio=10.0, replace=True)
        assert drive.steering
        assert read_steering(drive.steering) == pytest.approx(expected)


def test_start_and_end_leave_out_images(log: Path, video: Path) -> None:
    drive = take(video, log, motion=None, start=0.3, end=0.8)
    assert (list(drive.images(2)), drive.oxts, drive.steering) == ([3, 4, 5, 6, 7], {}, None)
    numbers, times = drive.timeline(2)
    np.testing.assert_allclose(read_times(times, numbers), np.arange(5) / 10, atol=1e-6)


@pytest.fixture
def presets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder instead of the project's presets."""
    (tmp_path / "presets").mkdir()
    monkeypatch.setattr(preset, "PRESETS", tmp_path / "presets")
    return tmp_path / "presets"


def write_longer(folder: Path) -> Path:
    """Write a video of 20 s, 10 images per second."""
    return write_video(folder / "longer.mp4", np.resize(pictures(FRAMES), (200, *SIZE, 3)))


@pytest.mark.parametrize(
    ("labels", "base", "horizon"), [("visual", "motion", 10), ("oxts", "motion", 0), ("wheel", "none", 0)]
)
def test_a_split_recording_has_a_preset_that_check_accepts(
    tmp_path: Path,
    presets: Path,
    labels: str,
    base: str,
    horizon: int,
) -> None:
    log, wheel = tmp_path / "can.csv", tmp_path / "wheel.csv"
    log.write_text(HEAD + "".join(f"{second},5,{second / 300}\n" for second in range(-1, 30)))
    wheel.write_text("time_s,wheel_rad\n" + "".join(f"{second},{second / 10}\n" for second in range(-1, 30)))
    options = {"wheel": wheel, "steering_ratio": 10.0} if labels == "wheel" else {}
    motion = log if labels == "oxts" else None
    first = take(write_longer(tmp_path), log, split="60,20,20", camera_height=1.4, motion=motion, **options)
    drives = [KittiDrive(path) for path in sorted(first.folder.parent.glob("*_sync"))]
    assert len(drives) == 3
    for drive in drives:
        assert list(drive.oxts) == (list(drive.images(2)) if labels == "oxts" else [])
        assert (drive.steering is not None) == (labels == "wheel")
        if drive.steering:
            assert list(read_steering(drive.steering)) == list(drive.images(2))

    (path,) = presets.iterdir()
    content = preset.merged(str(path))
    assert list(content["models"]) == ["motion", "scene"]
    settings = preset.validate(content, path)
    assert (settings.labels.source, settings.perception.camera_height_m) == (labels, 1.4)
    assert [*settings.ingest.drives.splits()] == [drive.folder.name.removesuffix("_sync") for drive in drives]
    assert (settings.models["motion"].base, settings.models["motion"].horizon) == (base, horizon)
    for model in settings.models.values():
        check.check_model(model, settings)


def test_a_repeated_import_is_noticed(tmp_path: Path, presets: Path, log: Path) -> None:
    """The preset has the hash of what was imported, so that params change with it; stage ingest compares the two."""

    def imported(angle: float) -> Path:
        wheel.write_text("time_s,wheel_rad\n" + "".join(f"{second},{angle}\n" for second in range(-1, 30)))
        options = {"wheel": wheel, "steering_ratio": 10.0, "replace": True}
        take(longer, log, motion=None, split="60,20,20", **options)
        content = yaml.safe_load((presets / f"{DRIVES[0]}.yaml").read_text())["ingest"]
        drives = {"train": [DRIVES[0]], "test": [DRIVES[1]]}
        return write_params(tmp_path / "params.yaml", **drives, manifests=content["manifests"])

    def ingested(params: Path) -> float:
        folder = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params, workers=1)
        with DriveReader(folder / f"{DRIVES[0]}.h5", stage="ingest") as file:
            return float(file["steering_rad"][0])

    longer, wheel = write_longer(tmp_path), tmp_path / "wheel.csv"
    params = imported(1.0)
    before = params.read_text()
    assert ingested(params) == pytest.approx(0.1)
    params = imported(-2.0)
    assert params.read_text() != before
    assert ingested(params) == pytest.approx(-0.2)
    params.write_text(before)
    with pytest.raises(InputError, match="imported again"):
        ingested(params)


def distorted(image: np.ndarray, K: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return what a camera with this distortion records of a scene that a pinhole records as `image`."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float64)
    ideal = cv2.undistortPoints(np.stack([u, v], -1).reshape(-1, 1, 2), K, coefficients, P=K).astype(np.float32)
    return cv2.remap(image, *np.moveaxis(ideal.reshape(*image.shape[:2], 2), -1, 0), cv2.INTER_LINEAR)


def test_distortion_is_removed_and_images_are_cropped_around_the_horizon(tmp_path: Path, log: Path) -> None:
    K, coefficients = np.array([[50, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]), np.array([-0.2, 0.03, 0, 0])
    images = np.stack([distorted(image, K, coefficients) for image in pictures(FRAMES)])
    folder, options = write_folder(tmp_path / "images", images), {"motion": None, "fps": 10.0, "fov": None}
    for drive, horizon in zip(DRIVES, (10.0, 30.0), strict=True):
        take(folder, log, drive, k="50,50,31.5,23.5", distortion="-0.2,0.03,0,0", horizon=horizon, **options)
    params = write_params(tmp_path / "params.yaml", [DRIVES[0]], [DRIVES[1]], image_size=[32, 128])
    ingested = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params, workers=1)
    for drive, first in zip(DRIVES, (3, 23), strict=True):  # 16 rows around the horizon, a little below
        with DriveReader(ingested / f"{drive}.h5", stage="ingest") as file:
            part = pictures(FRAMES)[5, first : first + 16]
            expected = cv2.resize(part, (128, 32), interpolation=cv2.INTER_LINEAR).astype(float)
            assert np.abs(file["image"][5] - expected)[2:-2, 4:-4].max() <= 2
            assert file["K"][1, 2] == pytest.approx(2 * (23.5 - first + 0.5) - 0.5)


CHANGES: list[Callable[[Path], object]] = [
    lambda drive: (drive / "notes.txt").write_text("mine"),
    lambda drive: (drive / MANIFEST).unlink(),  # as a drive of KITTI
]


@pytest.mark.parametrize("change", CHANGES)
def test_a_drive_is_replaced_only_as_it_was_imported(log: Path, video: Path, change: Callable[[Path], object]) -> None:
    take(video, log, motion=None)
    with pytest.raises(InputError, match="drive exists"):
        take(video, log)
    drive = take(video, log, replace=True)
    assert len(drive.oxts) == 10
    change(drive.folder)
    before = written(log)
    with pytest.raises(InputError, match="as steer import wrote it"):
        take(video, log, motion=None, replace=True)
    assert written(log) == before


def test_a_preset_is_replaced_only_as_it_was_imported(tmp_path: Path, presets: Path, log: Path) -> None:
    longer, path = write_longer(tmp_path), presets / f"{DRIVES[0]}.yaml"
    path.write_text("train: {epochs: 3}\n")
    with pytest.raises(InputError, match="as steer import wrote it"):
        take(longer, log, motion=None, split="60,20,20")
    assert written(log) == {}
    path.unlink()
    take(longer, log, motion=None, split="60,20,20")
    path.write_text(path.read_text().replace("epochs: 40", "epochs: 3"))
    with pytest.raises(InputError, match="as steer import wrote it"):
        take(longer, log, motion=None, split="60,20,20", replace=True)


def test_drives_of_a_date_share_the_camera(log: Path, video: Path) -> None:
    take(video, log)
    take(video, log, replace=True, fov=70.0)  # the only drive of its date may change it
    take(video, log, DRIVES[1], fov=70.0)
    for drive, replace in ((DRIVES[0], True), ("2027_03_31_drive_0003", False)):
        with pytest.raises(InputError, match="another camera"):
            take(video, log, drive, replace=replace)


HEAD = "time_s,speed_mps,yaw_rate_radps\n"
PLAINLY_WRONG: list[tuple[dict[str, Any], str]] = [
    ({"fov": None}, "--calib FILE"),
    ({"drive": "drive_1"}, "--drive"),
    ({"wheel": "frame,wheel_rad\n0,0\n12,0\n", "steering_ratio": 14.8}, "has frame 12, but the last image is 11"),
    ({"motion": HEAD + "-9,5,0\n-8,5,0\n9,5,0\n10,5,0\n"}, "--end or --offset"),
    ({"start": 3.0}, "--start"),
    ({"split": "60,20,30"}, "three shares"),
    ({"split": "60,20,20"}, "fewer than 2 images"),
]


@pytest.mark.parametrize(("options", "problem"), PLAINLY_WRONG)
def test_plainly_wrong_imports_write_nothing(
    presets: Path, log: Path, video: Path, options: dict[str, Any], problem: str
) -> None:
    for name in ("motion", "wheel"):
        if isinstance(options.get(name), str):
            path = log.with_name(f"{name}.csv")
            path.write_text(options[name])
            options = options | {name: path}
    with pytest.raises(InputError, match=problem):
        take(**{"recording": video, "log": log, "motion": None, **options})
    assert written(log) == {}
    assert [*presets.iterdir()] == []


@given(st.integers(0, 200), st.integers(700, 1000), st.integers(20, 60), st.integers(20, 39))
def test_parts_have_their_share_of_the_time_and_a_gap_between_them(first: int, last: int, train: int, val: int) -> None:
    time_s, shares = np.arange(1000) / 10, (train, val, 100 - train - val)
    usable = (np.arange(1000) >= first) & (np.arange(1000) < last)
    parts = cut(usable, time_s, shares)
    for share, part in zip(shares, parts, strict=True):
        assert not (part & ~usable).any()
        gap_s = 0 if part is parts[-1] else GAP_S
        assert np.ptp(time_s[part]) == pytest.approx(share / 100 * (last - first - 1) / 10 - gap_s, abs=0.21)
    for before, after in pairwise(parts):
        assert time_s[after].min() - time_s[before].max() >= GAP_S
