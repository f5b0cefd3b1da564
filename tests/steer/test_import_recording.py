"""steer import: what stage ingest and stage labels make of a recording is what its car's log says, or it is refused."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pipeline.camera.png import read_png

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.resume import ROOT
from pipeline.base.store import DriveReader
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
    """Import with a lens of 80 degrees into raw/ beside the log."""
    out = log.parent / "raw"
    import_recording(source, log, drive, **{"out": out, "fov": 80.0, **options})
    return RawDrive(out / drive[:10] / f"{drive}_sync")


def left_behind(log: Path) -> list[str]:
    return sorted(contents(log.parent / "raw")) if (log.parent / "raw").exists() else []


def test_labels_are_those_of_the_log(tmp_path: Path, log: Path, video: Path) -> None:
    """From an MPEG-4 video and from lossless images, by the stages that everybody runs."""
    times = tmp_path / "times.txt"
    times.write_text("".join(f"{time_s!r}\n" for time_s in TIMES_S.tolist()))
    take(video, log, DRIVES[0], times=times, quiet=True)
    take(write_folder(tmp_path / "images", pictures(FRAMES)), log, DRIVES[1], times=times, quiet=True)

    params = write_params(tmp_path / "params.yaml", [DRIVES[0]], [DRIVES[1]], image_size=list(SIZE))
    made = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params, workers=1)
    said = labels.main(ingest=made, out=tmp_path / "data/labels", params=params, workers=1)
    steering, valid = steering_labels(
        YAW_RATE_RADPS, SPEED_MPS, wheelbase_m=2.7, min_speed_mps=1.0, standstill="invalid"
    )
    for drive, lossless in zip(DRIVES, (False, True), strict=True):
        with DriveReader(said / f"{drive}.h5", stage="labels") as file:
            np.testing.assert_array_equal(file.frame, np.arange(FRAMES))
            np.testing.assert_allclose(file.time_s, TIMES_S - TIMES_S[0], atol=1e-6)
            np.testing.assert_allclose(file["steering_rad"], steering, atol=1e-6)
            np.testing.assert_array_equal(file["valid"], valid)
        with DriveReader(made / f"{drive}.h5", stage="ingest") as file:
            error = np.abs(file["image"].astype(float) - pictures(FRAMES))
            assert error.mean() < (1e-9 if lossless else 4)
            K = file["K"]
        assert np.rad2deg(2 * np.arctan(SIZE[1] / 2 / K[0, 0])) == pytest.approx(80)


def test_rates_are_resampled_to_the_video_s_clock_and_it_is_said(
    log: Path, video: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = take(video, log, offset=0.25)
    assert list(drive.oxts) == list(drive.images(2)) == list(range(3, FRAMES))  # images keep the video's numbers
    out = capsys.readouterr().out
    assert f"{DRIVES[0]}: 9 of 12 images, 64 x 48, 0.300 to 1.100 s, in " in out
    assert "12 samples of" in out
    assert "9 frames interpolated, samples up to 0.1" in out
    assert "without motion, left out: 3 before its first sample, 0 after its last, 0 in gaps" in out
    assert "ingest.source: kitti" in out
    packet = np.loadtxt(drive.oxts[5])
    assert packet[8] == pytest.approx(np.interp(0.5, TIMES_S + 0.25, SPEED_MPS), abs=1e-3)  # the video says 0.500 s
    assert packet[22] == pytest.approx(np.interp(0.5, TIMES_S + 0.25, YAW_RATE_RADPS), abs=1e-3)


def test_images_in_a_gap_of_the_log_are_left_out(tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[:4] + lines[8:]))
    images = write_folder(tmp_path / "images", pictures(FRAMES))
    drive = take(images, log, fps=10, max_gap=0.3, as_json=True)
    said = json.loads(capsys.readouterr().out)
    assert said["left_out"]["in_gaps"] == 12 - said["frames"] - said["left_out"]["before"] - said["left_out"]["after"]
    assert {3, 4, 5, 6}.isdisjoint(drive.oxts)
    assert (said["frames"], said["images"], said["size"]) == (len(drive.oxts), FRAMES, list(SIZE))
    assert 0.09 < said["largest_gap_s"] < 0.12
    assert said["K"][0][2] == 31.5


@pytest.mark.parametrize("kind", ["gpx", "nmea"])
def test_a_track_of_a_receiver(tmp_path: Path, log: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    time_s, places, heading = gnss.bend(30, 0.5)
    log.write_text(gnss.gpx(time_s, places) if kind == "gpx" else gnss.nmea(time_s, places, 9.0, heading))
    images = write_folder(tmp_path / "images", pictures(FRAMES))
    drive = take(images, log, fps=10, offset=-gnss.START.timestamp() - 5)
    packets = np.array([np.loadtxt(path) for path in drive.oxts.values()])
    np.testing.assert_allclose(packets[:, 8], 9.0, rtol=0.02)
    np.testing.assert_allclose(packets[:, 22], 0.1, rtol=0.04)
    heading_after_5_s = gnss.bend(FRAMES, 0.1)[2] + 0.5
    np.testing.assert_allclose(packets[:, 5], heading_after_5_s, atol=0.1)
    assert "fitted by parabolas over " in capsys.readouterr().out


def test_an_absolute_clock_of_both(tmp_path: Path, log: Path) -> None:
    time_s, places, heading = gnss.bend(30, 0.5)
    log.write_text(gnss.nmea(time_s, places, 9.0, heading))
    (tmp_path / "times.txt").write_text("".join(f"{gnss.START.timestamp() + 5 + i / 10:.3f}\n" for i in range(FRAMES)))
    drive = take(write_folder(tmp_path / "images", pictures(FRAMES)), log, times=tmp_path / "times.txt")
    assert len(drive.oxts) == FRAMES


def test_a_drive_that_is_there_is_replaced_only_by_force(tmp_path: Path, log: Path, video: Path) -> None:
    assert len(take(video, log).images(2)) == 10
    with pytest.raises(InputError, match=r"drive_0001_sync is there already: --force replaces it"):
        take(video, log)
    images = write_folder(tmp_path / "images", pictures(5))
    after = take(images, log, fps=10, force=True, fov=70.0)  # the only drive of its date: it may have another lens
    assert len(after.images(2)) == 4
    take(video, log, DRIVES[1], fov=70.0)
    with pytest.raises(InputError, match="has the calibration of another camera"):
        take(video, log, force=True)
    with pytest.raises(InputError, match="has the calibration of another camera"):
        take(video, log, "2027_03_31_drive_0003")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fov": None}, r"said nowhere: say one of --calib FILE .*--fov DEGREES.*--K fx,fy,cx,cy"),
        ({"fps": 10.0, "times": Path("a.txt")}, "--times and --fps both say"),
        ({"offset": 100.0}, r"0.000 to 1.100 s, and the motion's, 10\d.* do not overlap: --offset SECONDS"),
        ({"drive": "mine"}, "is not a drive's name"),
        ({"max_gap": 0.0}, "no image lies between two samples that are 0 s apart or less: raise --max-gap"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_written(
    log: Path, video: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        take(video, log, **options)
    assert left_behind(log) == []


def test_a_source_that_is_not_whole_leaves_nothing(tmp_path: Path, log: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (40, *SIZE, 3), np.uint8)
    cut = write_video(tmp_path / "cut.avi", noise, codec="MJPG")
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    with pytest.raises(DamagedFile, match=r"cut.avi ends after \d+ of the 40 images"):
        take(cut, log)
    mixed = write_folder(tmp_path / "mixed", [*pictures(3), *pictures(1, (40, 64))])
    with pytest.raises(InputError, match=r"000003.png is 64 x 40 pixels, the first image is 64 x 48"):
        take(mixed, log, fps=10)
    with pytest.raises(InputError, match="does not say when its images were taken"):
        take(write_folder(tmp_path / "images", pictures(3)), log)
    assert left_behind(log) == []


def test_an_interrupted_import_leaves_no_half_drive(log: Path, video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(take(video, log).folder.parent.parent)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(layout, "write_packets", interrupted)
    for drive in DRIVES:
        with pytest.raises(KeyboardInterrupt):
            take(video, log, drive, force=True)
    assert contents(log.parent / "raw") == before


def steer(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "steer", "import", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.slow
def test_the_command(tmp_path: Path, log: Path, video: Path) -> None:
    common = ("--motion", log, "--drive", DRIVES[0], "--out", tmp_path / "raw")
    done = steer(video, *common, "--fov", "80", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list((tmp_path / "raw").rglob("*.png"))) == 10
    (tmp_path / "no.mp4").write_text("no video")
    for source, options, error in (
        (video, (), "is there already"),
        (tmp_path / "no.mp4", ("--force", "--fov", "80"), "cannot be decoded as a video"),
        (video, ("--force", "--K", "1,2,3"), "--K 1,2,3 is not four numbers"),
    ):
        done = steer(source, *common, *options)
        assert (done.returncode, done.stdout) == (1, "")
        assert error in done.stderr
        assert done.stderr.startswith("error: ")
        assert done.stderr.count("\n") == 1
    assert "Traceback" in steer(video, *common, "--debug").stderr
    assert "Example: steer import drive.mp4 --motion can.csv" in " ".join(steer("--help").stdout.split())


@pytest.mark.slow
def test_ctrl_c(tmp_path: Path, log: Path) -> None:
    """In the middle of a long import: one line, status 130, no drive."""
    images = write_folder(tmp_path / "images", pictures(2, (400, 600)))
    for number in range(2, 3000):
        (images / f"{number:06d}.png").symlink_to(images / "000000.png")
    log.write_text("time_s,speed_mps,yaw_rate_radps\n0,5,0\n1000,5,0\n")
    command = [sys.executable, "-m", "steer", "import", images, "--motion", log, "--fps", "10", "--fov", "80"]
    command += ["--max-gap", "2000", "--drive", DRIVES[0], "--out", tmp_path / "raw"]
    process = subprocess.Popen([*map(str, command)], stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stderr
    while process.poll() is None and len(list((tmp_path / "raw").rglob("*.png"))) < 5:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    assert process.wait() == 130
    assert process.stderr.read() == "error: interrupted: no drive is written; run the same command again\n"
    process.stderr.close()
    assert left_behind(log) == []


@pytest.mark.real
def test_a_video_of_a_real_drive(real_kitti: Path, tmp_path: Path) -> None:
    """Its rates as a log, its grey images as a video, its calibration: its own speeds and yaw rates come back."""
    raw = RawDrive(real_kitti / "2011_10_03/2011_10_03_drive_0042_sync")
    packets = np.array([np.loadtxt(path) for path in raw.oxts.values()])
    images = [np.repeat(read_png(path)[..., None], 3, axis=-1) for path in raw.images(0).values()]
    rows = [f"{number / 10!r},{row[8]!r},{row[22]!r}\n" for number, row in enumerate(packets.tolist())]
    log = tmp_path / "can.csv"
    log.write_text("time_s,speed_mps,yaw_rate_radps\n" + "".join(rows))
    calib = raw.calibration / "calib_cam_to_cam.txt"
    drive = take(write_video(tmp_path / "a.mp4", images), log, fov=None, calib=calib, fps=10)
    imported = np.array([np.loadtxt(path) for path in drive.oxts.values()])
    np.testing.assert_allclose(imported[:, [8, 22]], packets[: len(imported), [8, 22]], atol=1e-9)
