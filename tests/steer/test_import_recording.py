"""steer import: the stages compute from a recording what its log holds, or the recording is refused."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.lock import exclusive
from pipeline.base.resume import ROOT
from pipeline.base.store import DriveReader
from pipeline.camera.pixels import read_pixels
from pipeline.kitti import steering_file
from pipeline.kitti.oxts import read_times
from pipeline.kitti.raw import RawDrive
from pipeline.label import steering_labels
from pipeline.recording import layout
from stages import ingest, labels
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
    assert (list(drive.images(2)), drive.oxts, drive.steering.exists()) == ([*range(FRAMES)], {}, False)
    numbers, times = drive.timeline(2)
    np.testing.assert_allclose(read_times(times, numbers), np.arange(FRAMES) / 10, atol=1e-6)

    drive = take(video, log, motion=None, wheel=log, steering_ratio=10.0, force=True)
    assert "labels.source: wheel" in capsys.readouterr().out
    expected = {number: 0.1 - 0.3 * (number / 10 - 0.05) / 0.6 for number in range(1, 7)}
    assert steering_file.read(drive.steering) == pytest.approx(expected)
    log.write_text("frame;wheel_rad\n4;1.5\n900;0\n")
    drive = take(video, log, motion=None, wheel=log, steering_ratio=10.0, force=True)
    assert steering_file.read(drive.steering) == {4: 0.15}


def test_offset_shifts_the_log(log: Path, video: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = take(video, log, offset=0.25)
    assert list(drive.oxts) == [3, 4, 5, 6, 7, 8, 9, 10, 11]
    packet = np.loadtxt(drive.oxts[5])
    assert packet[8] == pytest.approx(np.interp(0.5, TIMES_S + 0.25, SPEED_MPS), abs=1e-3)
    assert packet[22] == pytest.approx(np.interp(0.5, TIMES_S + 0.25, YAW_RATE_RADPS), abs=1e-3)
    text = capsys.readouterr().out
    assert f"{DRIVES[0]}: 9 of 12 images, 0.300 to 1.100 s" in text
    assert "3 before the first sample" in text


def test_gaps_of_the_log_are_left_out(tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[:4] + lines[8:]))
    images = write_folder(tmp_path / "images", pictures(FRAMES))
    drive = take(images, log, fps=10, max_gap=0.3, as_json=True)
    result = json.loads(capsys.readouterr().out)
    left_out = result["left_out"]
    assert left_out["in_gaps"] == 12 - result["frames"] - left_out["before"] - left_out["after"]
    assert {3, 4, 5, 6}.isdisjoint(drive.oxts)
    assert (result["frames"], result["images"], result["size"]) == (len(drive.oxts), FRAMES, list(SIZE))
    assert 0.09 < result["largest_gap_s"] < 0.12
    assert result["K"][0][2] == 31.5


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


def test_two_imports_at_once(log: Path, video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second is refused while the first writes, and also if the first ends before it gets the lock."""
    root = log.parent / "raw"
    with (
        exclusive(root / DRIVES[0][:10], root / ".import" / DRIVES[0][:10]),
        pytest.raises(InputError, match="another"),
    ):
        take(video, log)
    assert written(log) == {}

    def read_late(*arguments: Any) -> Any:
        monkeypatch.undo()
        take(video, log)
        return read_motion(*arguments)

    from pipeline.recording import motion_log

    read_motion = motion_log.read_motion
    monkeypatch.setattr(motion_log, "read_motion", read_late)
    with pytest.raises(InputError, match="drive exists"):
        take(video, log, fov=70.0)
    assert len(RawDrive(root / DRIVES[0][:10] / f"{DRIVES[0]}_sync").images(2)) == 10


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fov": None}, "--calib FILE"),
        ({"fps": 10.0, "times": Path("a.txt")}, "--times or --fps"),
        ({"fps": float("inf")}, "--fps"),
        ({"fps": float("nan")}, "--fps"),
        ({"fps": 0.0}, "--fps"),
        ({"offset": float("nan")}, "--offset"),
        ({"max_gap": -1.0}, "--max-gap"),
        ({"fov": None, "K": "1e308,1e308,20,20"}, "--K"),
        ({"offset": 100.0}, "--offset"),
        ({"drive": "mine"}, "--drive"),
        ({"drive": "0001_03_31_drive_0001"}, "--drive"),
        ({"max_gap": 0.0}, "--max-gap"),
        ({"steering_ratio": 14.8}, "--wheel"),
        ({"steering_ratio": 0.5}, "--steering-ratio"),
        ({"wheel": Path("no.csv"), "steering_ratio": 14.8}, "regular file"),
        ({"source": Path(os.fsdecode(b"\xff.mp4"))}, "UTF-8"),
    ],
)
def test_unusable_options_write_nothing(log: Path, video: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        take(**{"source": video, "log": log, **options})
    assert written(log) == {}


def test_incomplete_sources_write_nothing(tmp_path: Path, log: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (40, *SIZE, 3), np.uint8)
    cut = write_video(tmp_path / "cut.avi", noise, codec="MJPG")
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    mixed = write_folder(tmp_path / "mixed", [*pictures(3), *pictures(1, (40, 64))])
    untimed = write_folder(tmp_path / "untimed", pictures(3))
    with pytest.raises(DamagedFile):
        take(cut, log)
    with pytest.raises(InputError, match="64 x 40"):
        take(mixed, log, fps=10)
    with pytest.raises(InputError, match="no times"):
        take(untimed, log)
    assert written(log) == {}


def test_interrupt_keeps_what_was_there_and_a_kill_is_cleaned_up(
    log: Path, video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = take(video, log)
    before = written(log)
    killed = drive.folder.parent / f".{DRIVES[1]}_sync.abcd1234.tmp/{DRIVES[1]}_sync/oxts"
    killed.mkdir(parents=True)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(layout, "write_packets", interrupt)
    for name in DRIVES:
        with pytest.raises(KeyboardInterrupt):
            take(video, log, name, force=True)
    assert written(log) == before
    assert not killed.exists()


def accept_ctrl_c() -> None:
    """Undo that a background job ignores Ctrl-C, which its children inherit."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_command(tmp_path: Path, log: Path, video: Path) -> None:
    """Exit status and output of success, errors and Ctrl-C."""

    def command(*arguments: object) -> list[str]:
        common = ("--motion", log, "--drive", DRIVES[0], "--out", tmp_path / "raw")
        return [sys.executable, "-m", "steer", "import", *map(str, (*arguments, *common))]

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(command(*arguments), capture_output=True, text=True, cwd=ROOT, check=False)

    done = run(video, "--fov", "80", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list((tmp_path / "raw").rglob("*.png"))) == 10
    (tmp_path / "no.mp4").write_text("no video")
    done = run(tmp_path / "no.mp4", "--force", "--fov", "80")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith("error: ")

    before = written(log)
    images = write_folder(tmp_path / "images", pictures(2, (400, 600)))
    for number in range(2, 9000):
        (images / f"{number:06d}.png").symlink_to(images / "000000.png")
    log.write_text("time_s,speed_mps,yaw_rate_radps\n0,5,0\n1000,5,0\n")
    long = command(images, "--fps", "10", "--fov", "80", "--max-gap", "2000", "--force")
    with subprocess.Popen(long, stderr=subprocess.PIPE, text=True, cwd=ROOT, preexec_fn=accept_ctrl_c) as process:
        while process.poll() is None and len(list((tmp_path / "raw").rglob("*.png"))) < 15:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        assert process.wait() == 130
        assert process.stderr
        assert process.stderr.read().startswith("error: interrupted")
    assert written(log) == before


@pytest.mark.real
def test_video_of_a_real_drive(real_kitti: Path, tmp_path: Path) -> None:
    """Its rates as a log, its grey images as a video, its calibration: its speeds and yaw rates come back."""
    raw = RawDrive(real_kitti / "2011_10_03/2011_10_03_drive_0042_sync")
    packets = np.array([np.loadtxt(path) for path in raw.oxts.values()])
    images = [np.repeat(read_pixels(path)[..., None], 3, axis=-1) for path in raw.images(0).values()]
    rows = [f"{number / 10!r},{row[8]!r},{row[22]!r}\n" for number, row in enumerate(packets.tolist())]
    log = tmp_path / "can.csv"
    log.write_text("time_s,speed_mps,yaw_rate_radps\n" + "".join(rows))
    calib = raw.calibration / "calib_cam_to_cam.txt"
    drive = take(write_video(tmp_path / "a.mp4", images), log, fov=None, calib=calib, fps=10)
    imported = np.array([np.loadtxt(path) for path in drive.oxts.values()])
    np.testing.assert_allclose(imported[:, [8, 22]], packets[: len(imported), [8, 22]], atol=1e-9)
