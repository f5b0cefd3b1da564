"""Figures of the paper: which frames, and their numbers."""

from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.graphs import cloud
from pipeline.report import figures
from tests import street
from tests.pipeline.report import examples


def test_figures_are_numbered_without_gaps_where_images_are_there(tmp_path: Path) -> None:
    drive = examples.DRIVES[0]
    street.write_drive(tmp_path / "ingest", drive, 9)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", drive)
    with store.DriveWriter(tmp_path / f"clouds/pseudo/{drive}.h5", stage="clouds", drive=drive, params={}) as file:
        scenes = [street.scene(frame)[1:] for frame in range(9)]
        clouds = [cloud.pseudo_cloud(*scene, street.K, 80.0) for scene in scenes]
        cloud.write(file, np.arange(9), np.arange(9) / 10, clouds)
    table = examples.predictions(0.01).query("drive == @drive and frame < 9")
    examples.write_model(tmp_path, examples.metrics("net"), table)
    rng = np.random.default_rng(0)
    graph = {"frame": 5, "xyz_m": rng.uniform(-9, 9, (60, 3)).tolist(), "cls": [0] * 30 + [2] * 30}
    store.write_json(tmp_path / "evaluate/net/structure.json", {drive: graph})
    results = examples.load_results(tmp_path / "evaluate", ["net"])
    captions = figures.draw(tmp_path / "figures", results, tmp_path)
    assert [*captions] == ["chain", "street", "pruning", "paths", "errors-0"]
    assert [caption[:8] for caption in captions.values()][:4] == [f"Figure {number}" for number in range(1, 5)]
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == set(captions)


def test_the_largest_errors_are_apart_and_have_their_share() -> None:
    rows = examples.predictions(0.0).query("drive == @examples.DRIVES[0]").assign(driven_deg=0.0)
    table = rows.assign(model="net", elapsed_s=rows["frame"] / 10, predicted_deg=0.0)
    table.loc[table["frame"].isin([10, 11]), "predicted_deg"] = [3.0, 1.0]
    table.loc[table["frame"] == 25, "predicted_deg"] = -2.0
    found = figures.largest_errors(table)
    assert found["frame"].tolist()[:2] == [10, 25]
    np.testing.assert_allclose(found["share"][:2], [10 / 14, 4 / 14])
    assert len(found) == 2
