from pathlib import Path

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.sections.train import Train
from pipeline.train import augment, windows
from tests import artefacts

PARAMS = Path(__file__).resolve().parents[3] / "params.yaml"
DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    artefacts.write_dataset(tmp_path, DRIVES, frames=23, points=40)
    return tmp_path


def _batch(folder: Path, *spans: windows.Span, motion: str = "none") -> windows.Batch:
    drives = windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, motion=motion)
    (batch,) = windows.examples(drives, [spans], 8)
    return batch


def test_mirror_reflects_chosen_frames_and_twice_is_nothing(folder: Path) -> None:
    batch = _batch(folder, windows.Span(0, 0, 10), windows.Span(1, 0, 9))
    chosen = np.repeat([True, False], [10, 9])
    mirrored = augment.mirror(batch, chosen)
    points = batch["ptr"][10]
    assert (mirrored["xyz"][:points] == batch["xyz"][:points] * [-1, 1, 1]).all()
    assert (mirrored["xyz"][points:] == batch["xyz"][points:]).all()
    assert (mirrored["steering_rad"] == batch["steering_rad"] * [-1, -1, -1, 1, 1]).all()
    back = augment.mirror(mirrored, chosen)
    assert all((back[key] == batch[key]).all() for key in batch)


def test_a_world_twice_as_large_bends_half_as_much(folder: Path) -> None:
    batch = _batch(folder, windows.Span(0, 0, 10), windows.Span(1, 0, 9))
    scaled = augment.rescale(batch, np.repeat(np.array([2.0, 1.0], np.float32), [10, 9]))
    points = batch["ptr"][10]
    assert (scaled["xyz"][:points] == 2 * batch["xyz"][:points]).all()
    assert (scaled["xyz"][points:] == batch["xyz"][points:]).all()
    assert np.tan(scaled["steering_rad"]) == pytest.approx(np.tan(batch["steering_rad"]) / [2, 2, 2, 1, 1], rel=1e-6)


def test_the_motion_is_that_of_the_changed_world(tmp_path: Path) -> None:
    for write in (artefacts.write_graphs, artefacts.write_images):
        root = tmp_path / write.__name__
        artefacts.write_dataset(root, DRIVES, frames=12, write=write)
        for name in DRIVES:
            artefacts.add_motion(root / f"graphs/semantic/{name}.h5", "visual", np.linspace(-0.3, 0.4, 12))
        batch = _batch(root, windows.Span(0, 0, 10), windows.Span(1, 1, 10), motion="visual")
        mirrored = augment.mirror(batch, np.repeat([True, False], [10, 9]))
        signs = np.repeat([[-1, -1, 1, 1], [1, 1, 1, 1]], [10, 9], axis=0)
        assert (mirrored["motion"] == batch["motion"] * signs).all()
        scaled = augment.rescale(batch, np.repeat(np.array([2.0, 1.0], np.float32), [10, 9]))
        before, after = (each["motion"][:10].T.astype(np.float64) for each in (batch, scaled))
        factor = 1 if "image" in batch else 2
        assert np.tan(after[0]) == pytest.approx(np.tan(before[0]) / factor, rel=1e-5)
        assert np.tan(after[0]) == pytest.approx(artefacts.WHEELBASE_M * after[1] / after[2], rel=1e-5, abs=1e-6)
        assert (after[2] == factor * before[2]).all()
        assert (after[3] == before[3]).all()
        for changed in (mirrored, scaled):
            assert (changed["base_rad"] == changed["motion"][changed["windows"][:, -1], 0]).all()


def test_images_are_mirrored_left_right_and_know_no_scale(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, DRIVES, frames=12, write=artefacts.write_images)
    batch = _batch(tmp_path, windows.Span(0, 0, 10), windows.Span(1, 1, 10))
    chosen = np.repeat([True, False], [10, 9])
    mirrored = augment.mirror(batch, chosen)
    assert (mirrored["image"][:10] == batch["image"][:10, :, ::-1]).all()
    assert (mirrored["image"][10:] == batch["image"][10:]).all()
    assert (mirrored["steering_rad"] == batch["steering_rad"] * [-1, -1, -1, 1, 1]).all()
    # A larger world gives the same image, so the image cannot tell of wider bends.
    scaled = augment.rescale(batch, np.full(19, 2, np.float32))
    assert all((scaled[key] == batch[key]).all() for key in batch)


def test_neighbourhoods_stay_in_mirrored_and_rescaled_worlds(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, DRIVES, frames=12, write=artefacts.write_sets)
    batch = _batch(tmp_path, windows.Span(0, 0, 10))
    for changed, factor in (
        (augment.mirror(batch, np.full(10, True)), [-1, 1, 1]),
        (augment.rescale(batch, np.full(10, 2, np.float32)), 2),
    ):
        assert (changed["xyz"] == batch["xyz"] * factor).all()
        assert all((changed[key] == batch[key]).all() for key in batch if key not in ("xyz", "steering_rad"))


def test_a_change_is_of_whole_runs_and_each_share_of_them_has_its_own(folder: Path) -> None:
    settings = load(Train, PARAMS)
    change = augment.Change.draw(50, settings, np.random.default_rng(0))
    assert 10 < change.mirrored.sum() < 40
    assert (change.factor >= 1 / settings.rescale).all()
    assert (change.factor <= settings.rescale).all()
    own = change.of([3, 7])
    assert own.factor.tolist() == [change.factor[3], change.factor[7]]
    batch = _batch(folder, windows.Span(0, 0, 10), windows.Span(1, 0, 9))
    changed = augment.Change(np.array([True, False]), np.array([1, 2], np.float32)).apply(batch, [10, 9])
    points = batch["ptr"][10]
    assert (changed["xyz"][:points] == batch["xyz"][:points] * [-1, 1, 1]).all()
    assert (changed["xyz"][points:] == batch["xyz"][points:] * 2).all()


def test_switched_off_it_changes_nothing() -> None:
    settings = load(Train, PARAMS).model_copy(update={"mirror": False, "rescale": 1.0})
    change = augment.Change.draw(9, settings, np.random.default_rng(0))
    assert not change.mirrored.any()
    assert (change.factor == 1).all()
