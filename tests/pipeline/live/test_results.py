"""Results appear when a run succeeds; a full disk is an error, and a kill leaves a playable video."""

import resource
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.camera import Camera
from pipeline.live.frame_state import FrameState
from pipeline.live.overlay import Overlay
from pipeline.live.results import STEERING, UNFINISHED, VIDEO, result_folder
from pipeline.live.source import Source

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
    return Overlay(path, Source(path, "drive", Camera(K, SIZE), iter(()), None, FPS), 2.7)  # type: ignore[arg-type]


def decoded(path: Path) -> int:
    with av.open(str(path)) as file:
        return sum(1 for _ in file.decode(video=0))


def write(out: Path, text: str) -> None:
    with result_folder(out, STEERING, VIDEO) as folder:
        (folder / STEERING).write_text(text)
        if text == "fail":
            raise RuntimeError


def test_results_replace_earlier_ones_only_on_success(tmp_path: Path) -> None:
    (tmp_path / VIDEO).write_text("earlier")
    write(tmp_path, "first")
    assert (tmp_path / STEERING).read_text() == "first"
    assert not (tmp_path / VIDEO).exists()  # of another run
    with pytest.raises(RuntimeError):
        write(tmp_path, "fail")
    assert (tmp_path / STEERING).read_text() == "first"
    assert (tmp_path / UNFINISHED / STEERING).read_text() == "fail"
    with result_folder(tmp_path, STEERING, VIDEO), pytest.raises(InputError, match="another process"):
        write(tmp_path, "second")


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
