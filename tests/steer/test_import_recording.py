"""steer import: the stages compute from a recording what its log holds, or the recording is refused."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.atomic import exclusive
from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT
from pipeline.base.store import DriveReader
from pipeline.kitti import steering_file
from pipeline.kitti.oxts import read_times
from pipeline.kitti.raw import RawDrive
from pipeline.labels.label import steering_labels
from pipeline.recording import layout
from pipeline.settings import preset
from stages import check, ingest, labels
from steer.import_recording import import_recording
from tests import gnss
from tests.footage import SIZE, pictures, write_folder, write_video
from tests.kitti_drive import contents, write_params

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


def take(source: Path, log: Path, drive: str = DRIVES[0], **options: Any) -> RawDrive:
    """Import with a field of view of 80 degrees into raw/ beside the log."""
    out = log.parent / "raw"
    import_recording(source, drive, **{"motion": log, "out": out, "fov": 80.0, **options})
    return RawDrive(out / drive[:10] / f"{drive}_sync")


def written(log: Path) -> dict[str, bytes]:
    """Return the files below raw/, without those of the lock."""
    files = contents(log.parent / "raw") if (log.parent / "raw").exists() else {}
    return {name: content for name, content in files.items() if not name.startswith(".import/")}


def test_labels_follow_the_log(tmp_path: Path, log: Path, video: Path) -> None:
    """From an MPEG-4 video and from lossless images, through stages ingest and labels."""
    times = tmp_path / "times.txt"
    times.write_text("".join(f"{time_s!r}\n" for time_s in TIMES_S.tolist()))
    take(video, log, DRIVES[0], times=times, quiet=True)
    take(write_folder(tmp_path / "images", pictures(FRAMES)), log, DRIVES[1], times=times, quiet=True)

    params = write_params(tmp_path / "params.yaml", [DRIVES[0]], [DRIVES[1]], image_size=list(SIZE))
    ingested = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params, workers=1)
    labelled = labels.main(ingest=ingested, out=tmp_path / "data/labels", params=params)
    steering, valid = steering_labels(
        YAW_RATE_RADPS, SPEED_MPS, wheelbase_m=2.7, min_speed_mps=1.0, standstill="invalid"
    )
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


def test_without_motion_labels_come_from_images_or_the_wheel(
    tmp_path: Path, video: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "wheel.csv"
    log.write_text("time_s,wheel_rad\n0.05,1.0\n0.65,-2.0\n")
    drive = take(video, log, motion=None)
    assert "labels.source: visual" in capsys.readouterr().out
    assert (list(drive.images(2)), drive.oxts, drive.steering) == ([*range(FRAMES)], {}, None)
    numbers, times = drive.timeline(2)
    np.testing.assert_allclose(read_times(times, numbers), np.arange(FRAMES) / 10, atol=1e-6)

    drive = take(video, log, motion=None, wheel=log, steering_ratio=10.0, force=True)
    assert "labels.source: wheel" in capsys.readouterr().out
    expected = {number: 0.1 - 0.3 * (number / 10 - 0.05) / 0.6 for number in range(1, 7)}
    assert steering_file.read(drive.steering) == pytest.approx(expected)
    log.write_text(f"time_s,wheel_rad\n0.0,1.0\n{(FRAMES - 1) / 10 - 1e-15!r},2.0\n")  # ends 1e-15 s too early
    drive = take(video, log, motion=None, wheel=log, steering_ratio=10.0, force=True)
    assert steering_file.read(drive.steering)[FRAMES - 1] == pytest.approx(0.2)
    log.write_text("frame;wheel_rad\n4;1.5\n900;0\n")
    drive = take(video, log, motion=None, wheel=log, steering_ratio=10.0, force=True)
    assert steering_file.read(drive.steering) == {4: 0.15}


def test_start_and_end_leave_out_images(log: Path, video: Path) -> None:
    drive = take(video, log, motion=None, start=0.3, end=0.8)
    assert list(drive.images(2)) == [3, 4, 5, 6, 7]
    numbers, times = drive.timeline(2)
    np.testing.assert_allclose(read_times(times, numbers), np.arange(5) / 10, atol=1e-6)
    for options, message in (({"start": 3.0}, "--start"), ({"start": 2.0, "end": 1.0}, "--end 1 is not after")):
        with pytest.raises(InputError, match=message):
            take(video, log, DRIVES[1], motion=None, **options)


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
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    labels: str,
    base: str,
    horizon: int,
) -> None:
    monkeypatch.chdir(tmp_path)
    log, wheel = tmp_path / "can.csv", tmp_path / "wheel.csv"
    log.write_text("time_s,speed_mps,yaw_rate_radps\n-1,5,0\n30,5,0.1\n")
    wheel.write_text("time_s,wheel_rad\n-1,1.0\n30,-2.0\n")
    options = {
        "visual": {"motion": None},
        "oxts": {},
        "wheel": {"motion": None, "wheel": wheel, "steering_ratio": 10.0},
    }[labels]
    first = take(write_longer(tmp_path), log, split="60,20,20", max_gap=60.0, camera_height=1.4, **options)
    folders = [
        first.folder,
        *(first.folder.with_name(f"2027_03_31_drive_{number}_sync") for number in ("0002", "0003")),
    ]
    drives = [RawDrive(folder) for folder in folders]
    times_s = np.concatenate([np.array(list(drive.images(2))) / 10 for drive in drives])
    # Two seconds lie between the parts, so that no window of one shows what another has.
    assert np.flatnonzero(np.diff(times_s) > 0.11).size == 2
    assert np.diff(times_s).max() == pytest.approx(2.0, abs=0.15)
    for drive in drives:
        assert list(drive.oxts) == (list(drive.images(2)) if labels == "oxts" else [])
        assert (drive.steering is not None) == (labels == "wheel")
        if drive.steering:
            assert list(steering_file.read(drive.steering)) == list(drive.images(2))

    printed = capsys.readouterr().out
    link = f"ln -sfT {tmp_path}/raw/2027_03_31 {ROOT}/data/raw/2027_03_31"
    assert printed.endswith(f"{link} && make -C {ROOT} street && make -C {ROOT} {DRIVES[0]}\n")
    (path,) = presets.iterdir()
    content = preset.merged(str(path))
    assert list(content["models"]) == ["motion", "scene"]
    settings = preset.validate(content, path)
    assert (settings.labels.source, settings.perception.camera_height_m) == (labels, 1.4)
    assert [*settings.ingest.drives.splits()] == [drive.folder.name.removesuffix("_sync") for drive in drives]
    assert (settings.models["motion"].base, settings.models["motion"].horizon) == (base, horizon)
    for model in settings.models.values():
        check.check_model(model, settings)


def test_only_a_preset_of_steer_import_is_replaced(tmp_path: Path, presets: Path, log: Path) -> None:
    longer = write_longer(tmp_path)
    (presets / f"{DRIVES[0]}.yaml").write_text("train: {epochs: 3}\n")
    with pytest.raises(InputError, match="preset that steer import wrote"):
        take(longer, log, motion=None, split="60,20,20", force=True)
    assert written(log) == {}
    (presets / f"{DRIVES[0]}.yaml").unlink()
    for force in (False, True):
        take(longer, log, motion=None, split="60,20,20", force=force)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": "60,20"}, "three shares"),
        ({"split": "60,20,30"}, "three shares"),
        ({"split": "60,-20,60"}, "three shares"),
        ({"split": "a,b,c"}, "three shares"),
        ({"split": "60,20,20", "drive": "2027_03_31_drive_9998"}, "--drive"),
        ({"split": "98,1,1"}, "--split"),
    ],
)
def test_a_split_that_is_not_possible_writes_nothing(
    tmp_path: Path, presets: Path, log: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        take(write_longer(tmp_path), log, **{"motion": None, **options})
    assert written(log) == {}
    assert [*presets.iterdir()] == []


@pytest.mark.parametrize("kind", ["gpx", "nmea"])
def test_track_of_a_receiver(tmp_path: Path, log: Path, kind: str) -> None:
    time_s, places, heading = gnss.bend(30, 0.5)
    log.write_text(gnss.gpx(time_s, places) if kind == "gpx" else gnss.nmea(time_s, places, 9.0, heading))
    (tmp_path / "times.txt").write_text("".join(f"{gnss.START.timestamp() + 5 + i / 10:.3f}\n" for i in range(FRAMES)))
    drive = take(write_folder(tmp_path / "images", pictures(FRAMES)), log, times=tmp_path / "times.txt")
    packets = np.array([np.loadtxt(path) for path in drive.oxts.values()])
    np.testing.assert_allclose(packets[:, 8], 9.0, rtol=0.02)
    np.testing.assert_allclose(packets[:, 22], 0.1, rtol=0.04)
    np.testing.assert_allclose(packets[:, 5], gnss.bend(FRAMES, 0.1)[2] + 0.5, atol=0.1)


def test_existing_drive_is_replaced_only_with_force(tmp_path: Path, log: Path, video: Path) -> None:
    assert len(take(video, log).images(2)) == 10
    with pytest.raises(InputError) as raised:
        take(video, log)
    assert "--force" in raised.value.fix
    images = write_folder(tmp_path / "images", pictures(5))
    after = take(images, log, fps=10, force=True, fov=70.0)  # the only drive of its date may change the camera
    assert len(after.images(2)) == 4
    take(video, log, DRIVES[1], fov=70.0)
    for drive, force in ((DRIVES[0], True), ("2027_03_31_drive_0003", False)):
        with pytest.raises(InputError, match="another camera"):
            take(video, log, drive, force=force)


def test_a_failed_import_leaves_no_folder(log: Path, video: Path) -> None:
    log.write_text("time_s,speed_mps,yaw_rate_radps\n-9,5,0\n9,5,0\n")
    with pytest.raises(InputError, match="no image lies between samples"):
        take(video, log)
    assert [path.name for path in (log.parent / "raw").iterdir()] == [".import"]


def test_two_imports_at_once(log: Path, video: Path) -> None:
    root = log.parent / "raw"
    busy = exclusive(root / DRIVES[0][:10], root / ".import" / DRIVES[0][:10])
    with busy, pytest.raises(InputError, match="another"):
        take(video, log)
    assert written(log) == {}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fov": None}, "--calib FILE"),
        ({"fov": None, "k": "1e308,1e308,20,20"}, "--K"),
        ({"drive": "0001_03_31_drive_0001"}, "--drive"),
        ({"steering_ratio": 14.8}, "--wheel"),
        ({"wheel": Path("no.csv"), "steering_ratio": 14.8}, "regular file"),
        ({"source": Path(os.fsdecode(b"\xff.mp4"))}, "UTF-8"),
    ],
)
def test_unusable_options_write_nothing(log: Path, video: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        take(**{"source": video, "log": log, **options})
    assert written(log) == {}


def test_an_interrupt_keeps_what_was_there(log: Path, video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take(video, log)
    before = written(log)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(layout, "write_packets", interrupt)
    for name in DRIVES:
        with pytest.raises(KeyboardInterrupt):
            take(video, log, name, force=True)
    assert written(log) == before
