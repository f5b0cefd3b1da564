"""Images that a conversion to a higher rate repeats are left out."""

from collections.abc import Callable, Iterable

import cv2
import numpy as np
import pytest

from pipeline.motion.step import durations
from tests.kitti_drive import SIZE, pictures
from tests.pipeline.ingest.videos import images_of_a_street, open_recording, write_streams


@pytest.mark.parametrize(
    "how", [{}, {"crf": "28", "g": "15", "preset": "veryfast"}, ".jpg", ".png"], ids=str
)
@pytest.mark.parametrize(
    ("hz", "fps"), [(10, 12), (9.6, 29), (10, 24), (10, 30), (15, 25), (10, 60)]
)
def test_repeats_are_left_out_and_the_others_have_their_times(tmp_path, how, hz, fps):
    """In a conversion to a higher frame rate; the camera loses three images in a row."""
    taken_s = np.delete(np.arange(123) / hz, [60, 61, 62])
    shown_s = np.arange(int(122 / hz * fps)) / fps
    shown = np.searchsorted(taken_s, shown_s + 1e-9, side="right") - 1
    images = [images_of_a_street()[place] for place in shown]
    if isinstance(how, str):
        path = tmp_path / "images"
        path.mkdir()
        for number, image in enumerate(images):
            cv2.imwrite(str(path / f"{number}{how}"), image)
        recording = open_recording(path, fps=fps)
    else:
        stream = {"images": images, "fps": fps, "options": how}
        recording = open_recording(write_streams(tmp_path / "a.mp4", stream))

    # Each image is shown once.
    first = np.flatnonzero(np.diff(shown, prepend=-1))
    assert recording.kept.tolist() == first.tolist()
    assert recording.notes[0].startswith(f"{len(shown) - len(first)} of {len(shown)} images repeat")
    assert [frame.number for frame in recording.frames()] == list(range(len(first)))

    # Times are those of the camera, but for a constant.
    true_s = taken_s[: len(first)]
    late_s = np.mean(recording.times_s - true_s)
    assert recording.times_s == pytest.approx(true_s + late_s, abs=0.6 / fps)
    steps_s = durations(np.arange(len(first)), recording.times_s)[1:]
    assert steps_s == pytest.approx(np.diff(true_s), rel=0.06)


def noise(images: list[np.ndarray]) -> np.ndarray:
    return np.random.default_rng(0).normal(100, 5, (40, *SIZE, 3)).astype(np.uint8)


UNCHANGED: dict[str, Callable[[list[np.ndarray]], Iterable[np.ndarray]]] = {
    "standing": lambda images: images[:1] * 20,
    "traffic light": lambda images: [*images[:15], *images[15:16] * 20, *images[16:30]],
    "slow": lambda images: pictures(60),
    "night": lambda images: [image // 12 for image in images[:40]],
    "noise": noise,
}


@pytest.mark.parametrize("images", UNCHANGED.values(), ids=UNCHANGED)
@pytest.mark.parametrize("fps", [10, 30])
def test_other_unchanged_images_are_no_repeats(tmp_path, images, fps):
    for options in ({}, {"g": "4", "crf": "30"}):
        stream = {"images": list(images(images_of_a_street())), "fps": fps, "options": options}
        recording = open_recording(write_streams(tmp_path / "a.mp4", stream))
        count = len(recording.kept)
        assert count == len(stream["images"])
        assert recording.notes == []
        np.testing.assert_allclose(recording.times_s, np.arange(count) / fps, atol=1e-3)
