"""Figures of the paper: which frames, and their numbers."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base import store
from pipeline.camera.classes import VOID
from pipeline.graphs import cloud
from pipeline.report import figures
from tests import street
from tests.pipeline.report import examples


@pytest.mark.parametrize("with_classes", [True, False])
def test_figures_show_what_the_encoder_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_classes: bool) -> None:
    """With classes, figures are numbered without gaps; without, there is no image of them, and no pruning."""
    titles: list[str] = []
    monkeypatch.setattr(figures.Axes, "set_title", lambda _, title, **style: titles.append(title))
    drive = examples.DRIVES[0]
    street.write_drive(tmp_path / "ingest", drive, 9)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", drive)
    with store.DriveWriter(tmp_path / f"clouds/pseudo/{drive}.h5", stage="clouds", drive=drive, params={}) as file:
        scenes = [street.scene(frame)[1:] for frame in range(9)]
        clouds = [cloud.pseudo_cloud(*scene, street.K, 80.0) for scene in scenes]
        cloud.write(file, np.arange(9), np.arange(9) / 10, clouds)
    table = examples.predictions(0.01).query("drive == @drive and frame < 9")
    examples.write_model(tmp_path, examples.metrics("net"), table)
    if not with_classes:
        for name in (f"perception/{drive}.h5", f"clouds/pseudo/{drive}.h5"):
            with h5py.File(tmp_path / name, "a") as file:
                file["cls"][:] = VOID
    rng = np.random.default_rng(0)
    xyz_m = rng.uniform(-9, 9, (60, 3)).tolist()
    graph = {
        "frame": 5,
        "points": 60,
        "xyz_m": xyz_m,
        "cls": [0] * 30 + [2] * 30 if with_classes else [VOID] * 60,
        "edges": [],
    }
    store.write_json(tmp_path / "evaluate/net/structure.json", {drive: graph})
    results = examples.load_results(tmp_path / "evaluate", ["net"])
    captions = figures.draw(tmp_path / "figures", results, [], tmp_path)
    assert [*captions] == ["chain", "street", *["pruning"] * with_classes, "paths", "errors-0"]
    numbers = [1, 2, 3, 4] if with_classes else [1, 2, 4]
    assert [caption[:8] for caption in captions.values()][: len(numbers)] == [f"Figure {number}" for number in numbers]
    assert ("classes" in captions["street"]) == with_classes
    assert any("classes" in title for title in titles) == with_classes
    assert any("pruned to" in title for title in titles) == with_classes
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == set(captions)


def test_each_horizon_has_its_largest_errors_where_images_are_there(tmp_path: Path) -> None:
    drive = examples.DRIVES[0]
    street.write_drive(tmp_path / "ingest", drive, 9)  # of 30 frames
    table = examples.predictions(0.01)
    for horizon in (0, 10):
        examples.write_model(tmp_path, examples.metrics(f"net-{horizon}", horizon=horizon), table)
    captions = figures.draw(
        tmp_path / "figures", examples.load_results(tmp_path / "evaluate", ["net-0", "net-10"]), [], tmp_path
    )
    assert [*captions] == ["paths"]  # the images of the largest errors, frames 7 and later, are not there
    table.loc[table["frame"] == 8, "predicted_rad"] = 1.0
    examples.write_model(tmp_path, examples.metrics("net-10", horizon=10), table)
    results = examples.load_results(tmp_path / "evaluate", ["net-10"])
    captions = figures.draw(tmp_path / "figures", results, [], tmp_path)
    assert [*captions] == ["errors-10"]


def test_the_largest_errors_are_apart_and_have_their_share() -> None:
    rows = examples.predictions(0.0).assign(driven_deg=0.0, predicted_deg=0.0)
    table = rows.assign(elapsed_s=rows["frame"] / 10).reset_index(drop=True)
    first, frame = table["drive"] == examples.DRIVES[0], table["frame"]
    for number, error in ((10, 3.0), (15, 1.0), (25, -2.0)):
        table.loc[first & (frame == number), "predicted_deg"] = error
    table.loc[~first & (frame == 10), "predicted_deg"] = 2.5
    found = figures.largest_errors(table)
    assert found[["drive", "frame"]].to_numpy().tolist() == [
        [examples.DRIVES[0], 10], [examples.DRIVES[1], 10], [examples.DRIVES[0], 25]
    ]  # fmt: skip
    np.testing.assert_allclose(found["share"] * 20.25, [10, 6.25, 5])  # 15 counts for both of its neighbours
