"""Results appear when a run succeeds; a full disk is an error, and a kill leaves a playable video."""

import io
import resource
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.camera import Camera
from pipeline.camera.images import Crop
from pipeline.live.chain import Course, Estimate, FrameState
from pipeline.live.overlay import Overlay
from pipeline.live.results import (
    COLUMNS,
    MOTION,
    STEERING,
    TRACK,
    UNFINISHED,
    VIDEO,
    Results,
    check_out,
    comparison_lines,
    result_folder,
)
from pipeline.live.source import Source
from pipeline.motion.step import Step

SIZE, FPS = (96, 320), 10.0


def frames(count: int) -> list[FrameState]:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (count, *SIZE, 3), np.uint8)
    return [
        FrameState(row, row / FPS, source_image=image, predicted_rad=0.1, driven_rad=0.05)
        for row, image in enumerate(images)
    ]


def overlay(path: Path) -> Overlay:
    K = np.array([[200.0, 0, 160], [0, 200, 40], [0, 0, 1]])
    crop = Crop(slice(0, SIZE[0]), slice(0, SIZE[1]))
    return Overlay(path, Source(path, "drive", Camera(K, SIZE), crop, iter(()), None, FPS), 2.7)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("size", "K"),
    [((480, 640), (2152, 2166, 268, 210)), ((188, 620), (360, 360, 305, 86)), ((270, 480), (300, 300, 240, 130))],
)
def test_path_and_legend_are_inside_the_picture(tmp_path: Path, size: tuple[int, int], K: tuple[int, ...]) -> None:
    fx, fy, cx, cy = K
    camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), size, 1.5)
    source = Source(tmp_path, "drive", camera, Crop(slice(0, 9), slice(0, 9)), iter(()), None, FPS, truth="x")  # type: ignore[arg-type]
    black = np.zeros((*size, 3), np.uint8)
    frame = FrameState(0, 100.0, source_image=black, driven_rad=0.01, predicted_rad=0.01, sigma_rad=0.001)
    frame.problem = "too few points can be tracked"
    with Overlay(tmp_path / VIDEO, source, 2.7) as video:
        video.add(frame)
    with av.open(str(tmp_path / VIDEO)) as file:
        (image,) = (picture.to_ndarray(format="rgb24") for picture in file.decode(video=0))
    assert image.shape[:2] == size
    lit = (image.max(axis=2) > 60) & (np.arange(size[0])[:, None] > cy)
    assert lit.mean() > 0.02  # the path, below the horizon
    assert lit[:, round(cx)].any()
    text = (image.max(axis=2) > 60) & (np.arange(size[0])[:, None] < 0.6 * cy)
    assert text.any()
    assert not text[:, -8:].any()
    assert not black.any()  # the frame is not changed


def test_the_band_of_a_path_is_drawn_outside_of_it(tmp_path: Path) -> None:
    lit = []
    for sigma_1pm in (None, [0.02, 0.02]):
        camera = Camera(np.array([[200.0, 0, 160], [0, 200, 40], [0, 0, 1]]), SIZE, 1.5)
        source = Source(tmp_path, "drive", camera, Crop(slice(0, 9), slice(0, 9)), iter(()), None, FPS)  # type: ignore[arg-type]
        frame = FrameState(0, 0.0, source_image=np.zeros((*SIZE, 3), np.uint8), path_1pm=[0.0, 0.0])
        frame.path_sigma_1pm = sigma_1pm
        with Overlay(tmp_path / VIDEO, source, 2.7, ahead_m=[0, 10, 20]) as video:
            video.add(frame)
        with av.open(str(tmp_path / VIDEO)) as file:
            (image,) = (picture.to_ndarray(format="rgb24") for picture in file.decode(video=0))
        lit.append((image[..., 1] > 60) & (np.arange(SIZE[0])[:, None] > 55))  # green, below the legend
    without, with_band = lit
    assert with_band[:, :160].sum() > without[:, :160].sum()
    assert with_band[:, 160:].sum() > without[:, 160:].sum()


def decoded(path: Path) -> int:
    with av.open(str(path)) as file:
        return sum(1 for _ in file.decode(video=0))


HEADER = "drive,frame,time_s,predicted_rad\n"


@pytest.mark.parametrize("horizon", [0, 3])
def test_predictions_are_compared_with_the_angle_of_the_later_frame(horizon: int) -> None:
    """Without a frame and its truth, and without motion in the first frames."""
    numbers = np.setdiff1d(np.arange(200), [50])
    driven_rad = 0.1 * np.sin(np.arange(200 + horizon) / 20)
    results = Results(io.StringIO(), "drive", 1, COLUMNS[STEERING])
    for number in numbers.tolist():
        frame = FrameState(number, number / FPS, driven_rad=driven_rad[number] if number != 60 else None)
        frame.predicted_rad = 1.1 * driven_rad[number + horizon] if number >= 7 else None
        if number >= 20:
            frame.course = Course(5.0, 0.0, 0.0, driven_rad[number] + 0.01, 0.0, 0.0, 0.0)
            frame.estimates["visual"] = Estimate(Step(np.eye(4), 10, 0.5), 0.0, 5.0)
        results.add(frame)
    comparison = results.compare("oxts", "predicted", horizon)
    assert comparison is not None
    truth = {number: driven_rad[number] for number in numbers.tolist() if number != 60}
    used = [number for number in numbers.tolist() if number >= 7 and number + horizon in truth]
    target = np.array([truth[number + horizon] for number in used])
    assert comparison["frames"] == len(used)
    predicted, measured, zero = (comparison[name] for name in ("predicted", "measured", "zero"))
    assert predicted["nmse"] == pytest.approx(0.01)
    assert predicted["nmse_ci95"] == pytest.approx((0.01, 0.01))
    assert predicted["rmse_deg"] == pytest.approx(np.rad2deg(0.1 * np.sqrt((target**2).mean())))
    assert predicted["correlation"] == pytest.approx(1)
    held = np.array([driven_rad[number] + 0.01 if number >= 20 else 0.0 for number in used])
    assert measured["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(((held - target) ** 2).mean())))
    low, high = measured["nmse_ci95"]
    assert low < measured["nmse"] < high
    assert (zero["nmse"], zero["correlation"]) == (1, None)
    lines = list(comparison_lines(comparison))
    assert lines[0] == f"truth from oxts, {len(used)} frames{', 3 frames ahead' if horizon else ''}:"
    assert lines[1].startswith("  predicted: nmse 0.010 (0.010 to 0.010), RMSE 0.")
    assert results.compare("", "predicted", 1000) is None
    assert not list(comparison_lines(None))


@pytest.mark.parametrize(("count", "known"), [(50, False), (60, True)])
@pytest.mark.parametrize("fps", [10.0, 2.0])
def test_a_clip_of_five_seconds_has_no_interval(count: int, known: bool, fps: float) -> None:
    """Whatever the frame rate; an interval of zero width would claim certainty."""
    results = Results(io.StringIO(), "drive", 1, COLUMNS[STEERING])
    for number in range(round(count * fps / FPS)):
        state = FrameState(number, number / fps, driven_rad=0.1, predicted_rad=0.002 * number)
        results.add(state)
    comparison = results.compare("oxts", "predicted")
    assert comparison is not None
    assert (comparison["predicted"]["nmse_ci95"] is not None) == known
    assert any("(too short for an interval)" in line for line in comparison_lines(comparison)) == (not known)


def write(out: Path, rows: str) -> None:
    with result_folder(out, STEERING, VIDEO) as folder:
        (folder / STEERING).write_text(HEADER + rows)
        if rows == "fail":
            raise RuntimeError


def test_results_replace_earlier_ones_only_on_success(tmp_path: Path) -> None:
    write(tmp_path, "earlier")
    (tmp_path / VIDEO).write_text("earlier")
    write(tmp_path, "first")
    assert (tmp_path / STEERING).read_text() == HEADER + "first"
    assert not (tmp_path / VIDEO).exists()  # of another run
    with pytest.raises(RuntimeError):
        write(tmp_path, "fail")
    assert (tmp_path / STEERING).read_text() == HEADER + "first"
    assert (tmp_path / UNFINISHED / STEERING).read_text() == HEADER + "fail"
    with result_folder(tmp_path, STEERING, VIDEO), pytest.raises(InputError, match="another process"):
        write(tmp_path, "second")


def test_leftovers_of_a_killed_run_of_another_verb_are_removed(tmp_path: Path) -> None:
    killed = tmp_path / UNFINISHED / f".{TRACK}.abcd1234.tmp/{TRACK}"
    killed.parent.mkdir(parents=True)
    for path in (killed, tmp_path / UNFINISHED / MOTION, tmp_path / UNFINISHED / VIDEO):
        path.touch()
    write(tmp_path, "first")
    assert {path.name for path in tmp_path.iterdir()} == {STEERING, f"{UNFINISHED}.lock"}


@pytest.mark.parametrize(
    "name", [VIDEO, STEERING, UNFINISHED, f"{UNFINISHED}/notes.txt", f"{UNFINISHED}/{VIDEO}", f"{STEERING}/notes.txt"]
)
@pytest.mark.parametrize("linked", [False, True])
def test_files_that_this_program_did_not_write_are_refused_and_kept(tmp_path: Path, name: str, linked: bool) -> None:
    out, precious = tmp_path / "out", tmp_path / "precious"
    precious.mkdir()
    path = out / name
    path.parent.mkdir(parents=True)
    if linked:
        path.symlink_to(precious)
    elif name == f"{UNFINISHED}/{VIDEO}":
        (path / "notes.txt").mkdir(parents=True)
    else:
        path.write_text("frame,wheel_rad\n")
    (precious / STEERING).write_text("precious")
    for refusing in (lambda: check_out(out, (STEERING, VIDEO)), lambda: write(out, "first")):
        with pytest.raises(InputError, match=f"out/{name.removesuffix('/notes.txt')}"):
            refusing()
    assert path.is_symlink() or path.is_dir() or path.read_text() == "frame,wheel_rad\n"
    assert (precious / STEERING).read_text() == "precious"


def test_the_source_is_not_replaced_by_its_results(tmp_path: Path) -> None:
    write(tmp_path, "earlier")
    for folder in (tmp_path, tmp_path / UNFINISHED):
        folder.mkdir(exist_ok=True)
        (folder / VIDEO).touch()
        with pytest.raises(InputError, match="--out"):
            check_out(tmp_path, (STEERING, VIDEO), folder / VIDEO)


def test_a_file_that_appears_during_the_run_is_kept(tmp_path: Path) -> None:
    with result_folder(tmp_path, STEERING) as folder:
        (folder / STEERING).write_text(HEADER)
        (folder / "notes.txt").touch()
    assert (tmp_path / STEERING).exists()
    assert (folder / "notes.txt").exists()


def test_a_full_disk_is_an_error(tmp_path: Path) -> None:
    """RLIMIT_FSIZE limits a file as a full disk does."""

    def write_video() -> None:
        with overlay(tmp_path / VIDEO) as video:
            for frame in frames(30):
                video.add(frame)

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            write_video()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
def test_a_killed_run_leaves_a_playable_video(tmp_path: Path) -> None:
    code = (
        "import os, signal; from pathlib import Path; from tests.pipeline.live import test_results as t\n"
        f"video = t.overlay(Path({str(tmp_path / VIDEO)!r}))\n"
        "for frame in t.frames(35): video.add(frame)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    root = Path(__file__).resolve().parents[3]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == -9
    assert decoded(tmp_path / VIDEO) >= 20
