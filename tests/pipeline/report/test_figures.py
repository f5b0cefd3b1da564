"""Figures of the paper: which frames, and their numbers."""

from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.graphs import cloud
from pipeline.report.figures import draw, wheels
from tests import street
from tests.pipeline.report import examples

NEURONS = {
    "wiring": {
        "motor": 1, "command": 2, "inter": 3, "sensory": [[0, 3, 1], [1, 5, -1]],
        "internal": [[3, 1, 1], [4, 2, -1], [1, 2, 1], [2, 0, 1]],
    },
    "drive": "a", "frame": [3, 4, 5, 6], "steering_rad": [0.1, None, 0.2, 0.3],
    "activity": np.linspace(-1, 1, 24).reshape(4, 6).tolist(),
}  # fmt: skip


def test_frames_are_chosen_by_predictions() -> None:
    predicted = np.array([np.nan, 2.0, 11.0, -3.1, -10.0, -0.2, 5.0])
    assert wheels.choose(predicted) == {"left": 2, "slight right": 3, "sharp right": 4, "straight": 5}
    assert wheels.choose(np.array([1.0, 4.0])) == {"left": 1, "straight": 0}
    assert wheels.choose(np.array([np.nan])) == {}


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
    store.write_json(tmp_path / "evaluate/net/neurons.json", NEURONS)
    results = examples.load_results(tmp_path / "evaluate", ["net"])
    captions = draw.draw(tmp_path / "figures", results, tmp_path)
    assert [*captions] == ["chain", "street", "pruning", "wheels", "paths", "neurons"]
    assert [caption[:9] for caption in captions.values()] == [f"Figure {number}." for number in range(1, 7)]
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == set(captions)
