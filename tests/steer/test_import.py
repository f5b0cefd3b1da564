"""steer import: the stages compute what a recording's log holds, or the recording is refused."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.check import preset
from pipeline.labels.label import Car, steering_labels
from stages import check, ingest, labels
from stages.preset import PARAMS, Params, merged, to_yaml
from steer.commands.import_ import import_recording
from steer.import_recording import GAP_S, cut
from tests.kitti_drive import SIZE, contents, pictures, write, write_folder, write_video

FRAMES = 200
TIMES_S = np.arange(FRAMES) / 10 + np.random.default_rng(0).uniform(-0.004, 0.004, FRAMES)
SPEED_MPS = 6 + np.sin(TIMES_S)
YAW_RATE_RADPS = 0.3 * np.cos(3 * TIMES_S)
HEAD = "time_s,speed_mps,yaw_rate_radps\n"
ENDINGS = ("train", "val", "test")
STEADY = HEAD + "".join(f"{half / 2},5,{half / 600}\n" for half in range(-2, 60))


@pytest.fixture
def take(tmp_path, monkeypatch) -> Callable[..., dict[str, Any]]:
    """Return a function that imports recordings to an empty presets/ and returns the preset.

    The field of view is 80 degrees. Logs are given as text, one or a list.
    """
    (tmp_path / "presets").mkdir()
    monkeypatch.setattr(preset, "PRESETS", tmp_path / "presets")

    def imported(*recordings: Path, name: str = "monday", **options: Any) -> dict[str, Any]:
        for log in {"motion", "wheel"} & {*options}:
            texts = options[log]
            if isinstance(texts, str):
                texts = [texts]
            options[log] = [tmp_path / f"{log}-{number}.txt" for number in range(len(texts))]
            for file, text in zip(options[log], texts, strict=True):
                file.write_text(text)
        if "times" in options:
            (tmp_path / "times.txt").write_text(options["times"])
            options["times"] = tmp_path / "times.txt"
        if "wheel" in options:
            options.setdefault("steering_ratio", 10.0)
        import_recording([*recordings], **{"name": name, "fov_deg": 80.0, **options})
        return merged(str(tmp_path / f"presets/{name}.yaml"))

    return imported


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Write a video of 20 s, 10 images per second."""
    path = tmp_path_factory.mktemp("video") / "drive.mp4"
    return write_video(path, np.resize(pictures(12), (FRAMES, *SIZE, 3)))


@pytest.fixture(scope="module")
def videos(tmp_path_factory, video) -> list[Path]:
    """Return copies of the video with different bytes at the end."""
    paths = [tmp_path_factory.mktemp("videos") / f"{number}.mp4" for number in range(4)]
    for number, path in enumerate(paths):
        path.write_bytes(video.read_bytes() + b"\0\0\0\x09free" + bytes([number]))
    return paths


def every_second(angle: float) -> str:
    """Return a log of the steering wheel."""
    return "time_s,wheel_rad\n" + "".join(f"{half / 2},{angle}\n" for half in range(-2, 60))


def ingested(folder: Path, name: str = "monday", **changes: Any) -> Path:
    """Run stage ingest by a preset that was imported to `folder`; return the stage's folder."""
    params = folder / "params.yaml"
    params.write_text(to_yaml(merged(str(folder / f"presets/{name}.yaml")), "a test"))
    text = params.read_text()
    replacements = {"- 192\n  - 640": "- 48\n  - 64", **changes}
    for before, after in replacements.items():
        assert before in text
        text = text.replace(before, after)
    params.write_text(text)
    return ingest.main(folder / "data", folder / "data/raw", params)


@pytest.mark.parametrize(("name", "largest_error"), [("film", 4.0), ("lossless", 1e-9)])
def test_labels_follow_the_log(tmp_path, take, video, monkeypatch, name, largest_error):
    """An MPEG-4 video and lossless images pass through stages ingest and labels."""
    monkeypatch.chdir(preset.ROOT)
    rows = np.column_stack([TIMES_S, SPEED_MPS, YAW_RATE_RADPS]).tolist()
    log = HEAD + "".join(f"{t!r},{v!r},{w!r}\n" for t, v, w in rows)
    times = "".join(f"{time_s!r}\n" for time_s in TIMES_S.tolist())
    images = np.resize(pictures(12), (FRAMES, *SIZE, 3))
    recording = video
    if name == "lossless":
        recording = write_folder(tmp_path / "images", images)
    take(recording, name=name, motion=log, times=times)
    folder = ingested(tmp_path, name)
    labelled = labels.main(tmp_path / "data", tmp_path / "params.yaml")

    expected = steering_labels(YAW_RATE_RADPS, SPEED_MPS, Car(2.7, 1.0))
    frames = []
    for ending in ENDINGS:
        with DriveReader(labelled / f"{name}-{ending}.h5", stage="labels") as file:
            rows = file.frame
            time_s = TIMES_S[rows] - TIMES_S[rows[0]]
            np.testing.assert_allclose(file.time_s, time_s, atol=1e-6)
            steering_rad = expected.steering_rad[rows]
            np.testing.assert_allclose(file["steering_rad"], steering_rad, atol=1e-9)
            np.testing.assert_array_equal(file["valid"], expected.valid[rows])
        with DriveReader(folder / f"{name}-{ending}.h5", stage="ingest") as file:
            error = np.abs(file["image"].astype(float) - images[rows])
            assert error.mean() < largest_error
            assert file["K"][0, 2] == 31.5
        frames += rows.tolist()
    # All frames but 2 s before the second and the third part.
    assert frames == [*range(100), *range(120, 140), *range(160, FRAMES)]


def test_angles_of_the_wheel_are_interpolated_from_start_to_end(
    tmp_path, take, video, capsys, monkeypatch
):
    monkeypatch.chdir(preset.ROOT)
    rows = [f"{0.05 + half / 2},{1.0 - 0.1 * half}\n" for half in range(32)]
    log = "time_s,wheel_rad\n" + "".join(rows)
    take(video, wheel=log, steering_ratio=-10.0, start=2.3, end=18.0)
    text = capsys.readouterr().out
    assert "wheel-0.txt covers 133 of 157 images: wheel_rad -2.090 to 0.550" in text
    assert "113 of 157 images turn by wheel-0.txt (radius below 135 m)\n" in text
    folder = ingested(tmp_path)
    frames = []
    for ending in ENDINGS:
        with DriveReader(folder / f"monday-{ending}.h5", stage="ingest") as file:
            frames += file.frame.tolist()
            known = file.frame / 10 <= 15.55
            assert file["has_steering"].astype(bool).tolist() == known.tolist()
            expected = np.where(known, -0.1 + 0.02 * (file.frame / 10 - 0.05), 0)
            np.testing.assert_allclose(file["steering_rad"], expected, atol=1e-9)
    assert frames[0] == 23
    assert frames[-1] == 179


@pytest.mark.parametrize(
    ("labels_by", "options", "base", "horizon"),
    [
        (("motion", "computed"), {}, "motion", 10),
        (("ingest", "computed"), {"motion": STEADY}, "motion", 0),
        (("motion", "recorded"), {"wheel": every_second(1.0)}, "none", 0),
    ],
)
def test_the_preset_is_one_that_check_accepts(
    tmp_path, take, video, labels_by, options, base, horizon
):
    content = take(video, camera_height_m=1.4, **options)
    assert list(content["models"]) == ["motion", "scene"]
    settings = Params.model_validate(content)
    assert (settings.labels.source, settings.labels.angle) == labels_by
    assert {part.camera_height_m for part in settings.ingest.recordings.values()} == {1.4}
    assert settings.ingest.drives.splits() == {f"monday-{ending}": ending for ending in ENDINGS}
    assert settings.models["motion"].base == base
    assert settings.models["motion"].horizon == horizon
    for model in settings.models.values():
        check.check_model(model, settings)
    assert str(tmp_path) not in str(content)
    files = {path.name: path.is_symlink() for path in (tmp_path / "data/raw/monday").iterdir()}
    assert files == {"video.mp4": True, "scan.csv": False} | {f"{log}.csv": True for log in options}


def test_files_are_copied_on_a_disk_without_links(tmp_path, take, video, monkeypatch, capsys):
    refused = Mock(side_effect=PermissionError(1, "Operation not permitted"))
    monkeypatch.setattr(Path, "symlink_to", refused)
    take(video)
    note = "drive.mp4 is copied: a link cannot be made there (Operation not permitted)"
    assert note in capsys.readouterr().out
    assert (tmp_path / "data/raw/monday/video.mp4").read_bytes() == video.read_bytes()


def test_each_recording_is_a_drive_for_the_splits_in_turn(tmp_path, take, videos):
    cameras: dict[str, Any] = {"fov_deg": None, "K": ["50,50,31.5,23.5"] * 3 + ["60,60,31.5,23.5"]}
    logs = {"motion": [STEADY] * 4, **cameras}
    content = take(*videos, name="2027_03_31_drive_0004", each=True, copy=True, **logs)
    assert content["ingest"]["recordings"]["2027_03_31_drive_0007"]["K"] == "60,60,31.5,23.5"
    drives = Params.model_validate(content).ingest.drives
    assert [*drives.splits()] == [f"2027_03_31_drive_{number:04d}" for number in (4, 7, 5, 6)]
    copied = tmp_path / "data/raw/2027_03_31_drive_0004-4/video.mp4"
    assert copied.read_bytes() == videos[3].read_bytes()


def test_an_import_keeps_what_it_did_not_write(tmp_path, take, video, videos, monkeypatch):
    """Links of an earlier import are replaced, its copies only if they are as they were."""
    for _ in range(2):
        take(*videos[:3], each=True)
        take(*videos[:2], each=True)
        write(tmp_path / "data/raw/monday-1/.DS_Store", "")
    take(video, name="copied", copy=True, wheel=every_second(1.0))
    problem = r"copied/video.mp4: is in a folder that this import replaces"
    with pytest.raises(InputError, match=problem):
        take(tmp_path / "data/raw/copied/video.mp4", name="copied")
    write(tmp_path / "data/raw/copied/wheel.csv", every_second(-2.0))
    before = contents(tmp_path)
    with pytest.raises(InputError, match=r"copied/wheel.csv: is not as steer import wrote it"):
        take(video, name="copied", copy=True)
    assert contents(tmp_path) == before


def test_an_edited_log_is_refused_and_a_missing_file_only_if_it_is_needed(
    tmp_path, take, video, capsys, monkeypatch
):
    """Stage ingest refuses a file of another hash. Kept drives need no video."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_bytes(PARAMS.read_bytes())
    moved = tmp_path / "a.mp4"
    moved.write_bytes(video.read_bytes())
    take(moved, wheel=every_second(1.0))
    ingested(tmp_path)
    for file, name in ((tmp_path / "wheel-0.txt", "wheel.csv"), (moved, "video.mp4")):
        taken = file.read_bytes()
        file.write_bytes(b"edited")
        problem = rf"monday/{name}: is not the file whose hash .* Repeat steer import"
        with pytest.raises(InputError, match=problem):
            ingest.main(tmp_path / "data", tmp_path / "data/raw", tmp_path / "params.yaml")
        file.write_bytes(taken)
    moved.rename(tmp_path / "b.mp4")
    capsys.readouterr()
    (tmp_path / "params.yaml").write_bytes(PARAMS.read_bytes())
    ingested(tmp_path)
    assert "3 of 3 drives kept" in capsys.readouterr().out
    (tmp_path / "params.yaml").write_bytes(PARAMS.read_bytes())
    problem = rf"the link's target {moved} is missing. Repeat steer import"
    with pytest.raises(InputError, match=problem):
        ingested(tmp_path, **{"start: 12": "start: 13"})


def distorted(image: np.ndarray, K: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return the image of a lens with this distortion; `image` is that of a pinhole."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float64)
    pixels = np.stack([u, v], -1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixels, K, coefficients, P=K).astype(np.float32)
    ideal_u, ideal_v = np.moveaxis(ideal.reshape(*image.shape[:2], 2), -1, 0)
    return cv2.remap(image, ideal_u, ideal_v, cv2.INTER_LINEAR)


def test_distortion_is_removed_and_images_are_cropped_around_the_horizon(
    tmp_path, take, monkeypatch
):
    monkeypatch.chdir(preset.ROOT)
    K = np.array([[50, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
    coefficients = np.array([-0.2, 0.03, 0, 0])
    lens = {"K": ["50,50,31.5,23.5"], "distortion": "-0.2,0.03,0,0"}
    pixels = np.resize(pictures(12), (FRAMES, *SIZE, 3))
    images = np.stack([distorted(image, K, coefficients) for image in pixels])
    folder = write_folder(tmp_path / "images", images)
    # 16 rows around the horizon, a little below
    for name, horizon, first in (("low", 10.0, 3), ("high", 30.0, 23)):
        take(folder, name=name, fov_deg=None, horizon=horizon, fps=10.0, **lens)
        out = ingested(tmp_path, name, **{"- 192\n  - 640": "- 32\n  - 128"})
        with DriveReader(out / f"{name}-train.h5", stage="ingest") as file:
            expected = cv2.resize(pixels[5, first : first + 16], (128, 32))
            assert np.abs(file["image"][5].astype(float) - expected)[2:-2, 4:-4].max() <= 2
            assert file["K"][1, 2] == pytest.approx(2 * (23.5 - first + 0.5) - 0.5)


def other_video(folder: Path, video: Path) -> Path:
    """Return another video of the same name, as the next ride on an emptied card."""
    path = folder / "next/drive.mp4"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(video.read_bytes() + b"\0\0\0\x08free")
    return path


NOT_REPLACED: list[tuple[Callable[[Path, Path], object], Callable[[Path, Path], Path], str]] = [
    (
        lambda raw, video: write(raw / "notes.txt", "mine"),
        lambda _, video: video,
        "notes.txt: is not as steer import",
    ),
    (
        lambda raw, video: write(raw / ".git/config", "mine"),
        lambda _, video: video,
        "git: is not as steer import",
    ),
    (
        lambda raw, video: None,
        other_video,
        "video.mp4: is a copy of another recording, maybe the only one. Pass",
    ),
]


@pytest.mark.parametrize(("edit", "recording", "problem"), NOT_REPLACED)
def test_only_what_an_import_wrote_is_replaced(tmp_path, take, video, edit, recording, problem):
    take(video, copy=True)
    take(video, start=1.0, copy=True)
    edit(tmp_path / "data/raw/monday", video)
    path = recording(tmp_path, video)
    before = contents(tmp_path)
    with pytest.raises(InputError, match=problem):
        take(path, copy=True)
    assert contents(tmp_path).items() >= before.items()


def test_files_below_copied_images_stay(tmp_path, take):
    """A copy has only the images: an import reads no folders in a folder."""
    images = write_folder(tmp_path / "images", np.resize(pictures(12), (FRAMES, *SIZE, 3)))
    write(images / "masks/0.png", "of the source")
    take(images, fps=10.0, copy=True)
    frames = tmp_path / "data/raw/monday/frames"
    assert not (frames / "masks").exists()
    write(frames / "masks/0.png", "mine")
    problem = "frames/masks: is not as steer import wrote it. Move it away"
    with pytest.raises(InputError, match=problem):
        take(images, fps=10.0, copy=True)
    assert (frames / "masks/0.png").read_text() == "mine"


PLAINLY_WRONG = [
    ({"fov_deg": None}, "--fov DEGREES"),
    ({"name": "a b"}, "--name: expected at most 100 letters"),
    ({"name": "street"}, "street: is a target of make"),
    *(
        ({"name": name}, f"{name}: is the name of a file that stage report writes")
        for name in ("index", "metrics", "results", "table")
    ),
    ({"motion": HEAD + "-.2,5,0\n-.1,5,0\n20,5,0\n20.1,5,0\n20.2,5,0\n"}, "--end or --offset"),
    ({"motion": HEAD + "7200,5,0\n7200.1,5,0\n"}, "images from 0.0 to 19.9 s.*--offset -7200,"),
    ({"start": 30.0}, "--start"),
    ({"split": "60,20,30"}, "with the sum 100"),
    ({"split": "90,5,5"}, "fewer than 2 images"),
    ({"each": True}, "--each needs two recordings"),
    ({"wheel": every_second(1.0), "steering_ratio": 0.5}, "a magnitude of 1 to 50"),
    ({"wheel": every_second(1.0), "steering_ratio": "fit"}, "expected a number"),
    ({"wheel": [every_second(1.0)] * 2}, "--wheel: expected 1, one per recording"),
    ({"more": lambda video: [video.parent]}, "is a folder among several files"),
    ({"more": lambda video: [video]}, "has the same content as .*drive.mp4"),
    ({"more": lambda video: [video], "each": True}, "has the same content as .*drive.mp4"),
    (
        {"motion": [STEADY, "time_s,speed\n"], "each": True, "more": lambda video: [video.parent]},
        "motion-1.txt: has no column speed_mps",
    ),
]


@pytest.mark.parametrize(("options", "problem"), PLAINLY_WRONG)
def test_plainly_wrong_imports_write_nothing(tmp_path, take, video, options, problem):
    more = options.pop("more", lambda video: [])(video)
    with pytest.raises(InputError, match=problem):
        take(video, *more, **options)
    assert [name for name in contents(tmp_path) if name.startswith(("data", "presets"))] == []


def test_a_file_or_a_link_in_the_place_of_a_folder_stays(tmp_path, take, video):
    raw = tmp_path / "data/raw"
    place = raw / "monday"
    problem = "raw/monday: is a link or a file, expected a folder by steer import"
    write(place, "mine")
    with pytest.raises(InputError, match=problem):
        take(video)

    place.unlink()
    place.symlink_to(video.parent)
    with pytest.raises(InputError, match=problem):
        take(video)

    place.unlink()
    raw.rmdir()
    raw.symlink_to(tmp_path / "gone")
    with pytest.raises(InputError, match="data/raw: is a link to a folder that is missing"):
        take(video)
    assert [*(tmp_path / "presets").iterdir()] == []


def test_another_checkout_is_refused(tmp_path, take, video, monkeypatch):
    for name in ("params.yaml", "dvc.yaml", "presets/kitti.yaml"):
        write(tmp_path / "worktree" / name, "")
    (tmp_path / "worktree/street").mkdir()
    monkeypatch.chdir(tmp_path / "worktree/street")
    problem = r"worktree: is not the checkout of the installed steer, .*python -m steer"
    with pytest.raises(InputError, match=problem):
        take(video)
    assert [*(tmp_path / "presets").iterdir()] == []


@given(st.integers(0, 200), st.integers(700, 1000), st.integers(20, 60), st.integers(20, 39))
def test_parts_have_their_share_of_the_time_and_a_gap_between_them(first, last, train, val):
    number = np.arange(1000)
    time_s = number / 10
    usable = (number >= first) & (number < last)
    shares = (train, val, 100 - train - val)
    parts = cut(usable, time_s, shares)
    gaps_s = (GAP_S, GAP_S, 0)
    for share, gap_s, part in zip(shares, gaps_s, parts, strict=True):
        assert not (part & ~usable).any()
        length_s = share / 100 * (last - first - 1) / 10 - gap_s
        assert np.ptp(time_s[part]) == pytest.approx(length_s, abs=0.21)
    for before, after in pairwise(parts):
        assert time_s[after].min() - time_s[before].max() >= GAP_S
