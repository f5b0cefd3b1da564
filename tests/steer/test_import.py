"""steer import: the stages compute from a recording what its log holds, or the recording is refused."""

import errno
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import Mock

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
from pipeline.labels.label import Car, steering_labels
from pipeline.settings import preset
from pipeline.video.import_recording import GAP_S, cut
from stages import check, ingest, labels
from steer.import_ import import_recording
from tests.kitti_drive import SIZE, contents, pictures, write, write_folder, write_params, write_video

DRIVES = ("2027_03_31_drive_0001", "2027_03_31_drive_0002")
FRAMES = 12
TIMES_S = np.arange(FRAMES) / 10 + np.random.default_rng(0).uniform(-0.004, 0.004, FRAMES)
SPEED_MPS, YAW_RATE_RADPS = 6 + np.sin(TIMES_S), 0.3 * np.cos(3 * TIMES_S)
HEAD = "time_s,speed_mps,yaw_rate_radps\n"


@pytest.fixture
def take(tmp_path, monkeypatch) -> Callable[..., KittiDrive]:
    """Import with a field of view of 80 degrees into raw/; logs are given as text, presets/ is empty."""
    (tmp_path / "presets").mkdir()
    monkeypatch.setattr(preset, "PRESETS", tmp_path / "presets")

    def imported(recording: Path, drive: str = DRIVES[0], **options: Any) -> KittiDrive:
        for name in {"motion", "wheel", "times"} & {*options}:
            (tmp_path / f"{name}.txt").write_text(options[name])
            options[name] = tmp_path / f"{name}.txt"
        if "wheel" in options:
            options["steering_ratio"] = 10.0
        import_recording(recording, drive, **{"out": tmp_path / "raw", "fov": 80.0, **options})
        return KittiDrive(tmp_path / f"raw/{drive[:10]}/{drive}_sync")

    return imported


@pytest.fixture
def video(tmp_path) -> Path:
    return write_video(tmp_path / "drive.mp4", pictures(FRAMES))


@pytest.fixture
def longer(tmp_path) -> Path:
    """A video of 20 s, 10 images per second."""
    return write_video(tmp_path / "longer.mp4", np.resize(pictures(FRAMES), (200, *SIZE, 3)))


def every_second(angle: float) -> str:
    """Return a log of the steering wheel."""
    return "time_s,wheel_rad\n" + "".join(f"{half / 2},{angle}\n" for half in range(-2, 60))


def test_labels_follow_the_log(tmp_path, take, video):
    """From an MPEG-4 video and from lossless images, through stages ingest and labels."""
    rows = np.column_stack([TIMES_S, SPEED_MPS, YAW_RATE_RADPS]).tolist()
    log = HEAD + "".join(f"{t!r},{v!r},{w!r}\n" for t, v, w in rows)
    times = "".join(f"{time_s!r}\n" for time_s in TIMES_S.tolist())
    for drive, recording in zip(DRIVES, (video, write_folder(tmp_path / "images", pictures(FRAMES))), strict=True):
        take(recording, drive, motion=log, times=times)

    params = write_params(tmp_path / "params.yaml", [DRIVES[0]], [DRIVES[1]], image_size=list(SIZE))
    ingested = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params)
    labelled = labels.main(ingest=ingested, out=tmp_path / "data/labels", params=params)
    steering, valid, *_ = steering_labels(YAW_RATE_RADPS, SPEED_MPS, Car(2.7, 1.0))
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


def test_angles_of_the_wheel_are_interpolated_from_start_to_end(take, video, capsys):
    drive = take(video, wheel="time_s,wheel_rad\n0.05,1.0\n0.55,-2.0\n")
    expected = {number: 0.1 - 0.3 * (number / 10 - 0.05) / 0.5 for number in range(1, 6)}
    assert read_steering(drive.steering) == pytest.approx(expected)
    assert "wheel.txt covers 5 of 12 images" in capsys.readouterr().out
    drive = take(video, wheel="time_s;wheel_rad\n0.4;1.5\n0.6;3.0\n", start=0.3, end=0.8, replace=True)
    assert (list(drive.images(2)), drive.oxts) == ([3, 4, 5, 6, 7], {})
    assert read_steering(drive.steering) == pytest.approx({4: 0.15, 5: 0.225, 6: 0.3})
    numbers, times = drive.timeline(2)
    np.testing.assert_allclose(read_times(times, numbers), np.arange(5) / 10, atol=1e-6)


@pytest.mark.parametrize(
    ("source", "options", "base", "horizon"),
    [
        ("visual", {}, "motion", 10),
        ("oxts", {"motion": HEAD + "".join(f"{half / 2},5,{half / 600}\n" for half in range(-2, 60))}, "motion", 0),
        ("wheel", {"wheel": every_second(1.0)}, "none", 0),
    ],
)
def test_a_split_recording_has_a_preset_that_check_accepts(take, longer, source, options, base, horizon):
    first = take(longer, split="60,20,20", camera_height=1.4, **options)
    drives = [KittiDrive(path) for path in sorted(first.folder.parent.glob("*_sync"))]
    for drive in drives:
        assert list(drive.oxts) == (list(drive.images(2)) if source == "oxts" else [])
        assert (drive.steering is not None) == (source == "wheel")

    (path,) = preset.PRESETS.iterdir()
    content = preset.merged(str(path))
    assert list(content["models"]) == ["motion", "scene"]
    settings = preset.Params.model_validate(content)
    assert (settings.labels.source, settings.perception.camera_height_m) == (source, 1.4)
    assert [*settings.ingest.drives.splits()] == [drive.folder.name.removesuffix("_sync") for drive in drives]
    assert (settings.models["motion"].base, settings.models["motion"].horizon) == (base, horizon)
    for model in settings.models.values():
        check.check_model(model, settings)


def test_a_repeated_import_is_noticed(tmp_path, take, longer):
    """The preset has the hash of what was imported, so that params change with it; stage ingest compares the two."""
    folders = {"raw": tmp_path / "raw", "out": tmp_path / "data/ingest"}
    for wheel_rad in (1.0, -2.0):
        take(longer, split="60,20,20", wheel=every_second(wheel_rad), replace=True)
        manifests = yaml.safe_load((preset.PRESETS / f"{DRIVES[0]}.yaml").read_text())["ingest"]["manifests"]
        params = write_params(tmp_path / f"{wheel_rad}.yaml", [DRIVES[0]], [DRIVES[1]], manifests=manifests)
        with DriveReader(ingest.main(**folders, params=params) / f"{DRIVES[0]}.h5", stage="ingest") as file:
            assert file["steering_rad"][0] == pytest.approx(wheel_rad / 10)
    with pytest.raises(InputError, match="imported again"):
        ingest.main(**folders, params=tmp_path / "1.0.yaml")


def distorted(image: np.ndarray, K: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return what a camera with this distortion records of a scene that a pinhole records as `image`."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float64)
    ideal = cv2.undistortPoints(np.stack([u, v], -1).reshape(-1, 1, 2), K, coefficients, P=K).astype(np.float32)
    return cv2.remap(image, *np.moveaxis(ideal.reshape(*image.shape[:2], 2), -1, 0), cv2.INTER_LINEAR)


def test_distortion_is_removed_and_images_are_cropped_around_the_horizon(tmp_path, take):
    K, coefficients = np.array([[50, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]), np.array([-0.2, 0.03, 0, 0])
    images = np.stack([distorted(image, K, coefficients) for image in pictures(FRAMES)])
    folder, lens = write_folder(tmp_path / "images", images), {"k": "50,50,31.5,23.5", "distortion": "-0.2,0.03,0,0"}
    for drive, horizon in zip(DRIVES, (10.0, 30.0), strict=True):
        take(folder, drive, fov=None, horizon=horizon, fps=10.0, **lens)
    params = write_params(tmp_path / "params.yaml", [DRIVES[0]], [DRIVES[1]], image_size=[32, 128])
    ingested = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params)
    for drive, first in zip(DRIVES, (3, 23), strict=True):  # 16 rows around the horizon, a little below
        with DriveReader(ingested / f"{drive}.h5", stage="ingest") as file:
            part = pictures(FRAMES)[5, first : first + 16]
            expected = cv2.resize(part, (128, 32), interpolation=cv2.INTER_LINEAR).astype(float)
            assert np.abs(file["image"][5] - expected)[2:-2, 4:-4].max() <= 2
            assert file["K"][1, 2] == pytest.approx(2 * (23.5 - first + 0.5) - 0.5)


CHANGES: list[Callable[[Path, Path], object]] = [
    lambda drive, preset: (drive / "notes.txt").write_text("mine"),
    lambda drive, preset: (drive / MANIFEST).unlink(),  # as a drive of KITTI
    lambda drive, preset: preset.write_text(preset.read_text().replace("epochs: 40", "epochs: 3")),
]


@pytest.mark.parametrize("change", CHANGES)
def test_only_what_an_import_wrote_is_replaced(tmp_path, take, longer, change):
    take(longer, split="60,20,20")
    with pytest.raises(InputError, match="drive exists"):
        take(longer)
    drive = take(longer, split="60,20,20", start=1.0, replace=True)
    change(drive.folder, preset.PRESETS / f"{DRIVES[0]}.yaml")
    before = contents(tmp_path)
    with pytest.raises(InputError, match="as steer import wrote it"):
        take(longer, split="60,20,20", replace=True)
    assert contents(tmp_path) == before


def test_drives_of_a_date_share_the_camera(take, video):
    take(video)
    take(video, replace=True, fov=70.0)  # the only drive of its date may change it
    take(video, DRIVES[1], fov=70.0)
    for drive, replace in ((DRIVES[0], True), ("2027_03_31_drive_0003", False)):
        with pytest.raises(InputError, match="another camera"):
            take(video, drive, replace=replace)


def test_a_failed_or_killed_import_leaves_nothing(tmp_path, take, video, monkeypatch):
    write(tmp_path / f"raw/2027_03_31/.{DRIVES[0]}_sync.killed.tmp/0.png", "half an image")
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.video.import_recording.write_png", Mock(side_effect=OSError(errno.ENOSPC, "No space")))
        with pytest.raises(InputError, match=r"raw/2027_03_31: disk is full: images need up to 0 MB"):
            take(video)
    assert not any((tmp_path / "raw").iterdir())
    assert len(take(video).images(2)) == FRAMES


PLAINLY_WRONG = [
    ({"fov": None}, "--fov DEGREES"),
    ({"drive": "drive_1"}, "--drive"),
    ({"motion": HEAD + "-.2,5,0\n-.1,5,0\n2,5,0\n2.1,5,0\n2.2,5,0\n"}, "--end or --offset"),
    ({"motion": HEAD + "7200,5,0\n7200.1,5,0\n"}, "images from 0.0 to 1.1 s.*--offset -7200,"),
    ({"start": 3.0}, "--start"),
    ({"split": "60,20,30"}, "with the sum 100"),
    ({"split": "60,20,20"}, "fewer than 2 images"),
]


@pytest.mark.parametrize(("options", "problem"), PLAINLY_WRONG)
def test_plainly_wrong_imports_write_nothing(tmp_path, take, video, options, problem):
    with pytest.raises(InputError, match=problem):
        take(video, **options)
    assert [name for name in contents(tmp_path) if name.startswith(("raw", "presets"))] == []


@given(st.integers(0, 200), st.integers(700, 1000), st.integers(20, 60), st.integers(20, 39))
def test_parts_have_their_share_of_the_time_and_a_gap_between_them(first, last, train, val):
    time_s, shares = np.arange(1000) / 10, (train, val, 100 - train - val)
    usable = (np.arange(1000) >= first) & (np.arange(1000) < last)
    parts = cut(usable, time_s, shares)
    for share, part in zip(shares, parts, strict=True):
        assert not (part & ~usable).any()
        gap_s = 0 if part is parts[-1] else GAP_S
        assert np.ptp(time_s[part]) == pytest.approx(share / 100 * (last - first - 1) / 10 - gap_s, abs=0.21)
    for before, after in pairwise(parts):
        assert time_s[after].min() - time_s[before].max() >= GAP_S
