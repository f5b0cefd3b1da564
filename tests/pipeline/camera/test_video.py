"""Videos: frames, times, and faults of files."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.footage import open_footage
from pipeline.camera.video import Video
from tests.footage import SIZE, pictures, write_video


@pytest.mark.parametrize("kind", ["mp4", "mkv"])
def test_frames_and_times_of_the_container(tmp_path: Path, kind: str) -> None:
    images = pictures(12)
    video = open_footage(write_video(tmp_path / f"a.{kind}", images, fps=12.5))
    assert isinstance(video, Video)
    assert (video.size, video.fps, video.count) == (SIZE, 12.5, 12)
    frames = list(video.frames())
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(12) / 12.5, atol=1e-3)
    assert video.untimed_from is None
    assert np.abs(np.array([frame.image for frame in frames], float) - images).mean() < 4
    assert len(list(video.frames())) == 12  # a second pass


def test_changing_size_is_refused(tmp_path: Path) -> None:
    """A stream of JPEGs, two of which have another size."""
    images = [*pictures(3), *pictures(2, (40, 64))]
    path = tmp_path / "a.mjpeg"
    path.write_bytes(b"".join(cv2.imencode(".jpg", image)[1].tobytes() for image in images))
    frames = open_footage(path).frames()
    assert [next(frames).number for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputError, match=r"frame 3 has 64 x 40 pixels .*64 x 48"):
        next(frames)


@pytest.mark.parametrize("kind", ["avi", "mkv"])
def test_truncated_video_yields_what_it_has_and_fails(tmp_path: Path, kind: str) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (40, *SIZE, 3), np.uint8)
    path = write_video(tmp_path / f"a.{kind}", noise, codec="MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    frames, numbers = open_footage(path).frames(), list[int]()
    with pytest.raises(DamagedFile) as raised:
        numbers.extend(frame.number for frame in frames)
    assert raised.value.where == str(path)
    assert 5 < len(numbers) < 35
