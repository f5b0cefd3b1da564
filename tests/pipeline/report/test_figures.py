"""Figures of the paper: which frames, what they show, the same bytes each time."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base import store
from pipeline.graphs import cloud
from pipeline.report.figures import chain, draw, neurons, paths, wheels
from pipeline.report.judge.paths import Track
from pipeline.report.street_view import View
from tests import street
from tests.pipeline.report import examples

IMAGE = np.zeros((40, 120, 3), np.uint8)
NEURONS = {
    "wiring": {
        "motor": 1, "command": 2, "inter": 3, "sensory": [[0, 3, 1], [1, 5, -1]],
        "internal": [[3, 1, 1], [4, 2, -1], [1, 2, 1], [2, 0, 1]],
    },
    "drive": "a", "frame": [3, 4, 5, 6], "steering_rad": [0.1, None, 0.2, 0.3],
    "activity": np.linspace(-1, 1, 24).reshape(4, 6).tolist(),
}  # fmt: skip


def draw_wheels(path: Path) -> None:
    examples_ = [wheels.Example("left", IMAGE, 12.34, 14.0), wheels.Example("straight", IMAGE, -0.01, 0.0)]
    wheels.draw(path, "net", examples_)


def draw_neurons(path: Path) -> None:
    neurons.draw(path, "net", NEURONS)


def draw_paths(path: Path) -> None:
    track = Track(np.arange(40) / 10, np.full(40, 8.0), np.zeros(40), np.array([20]), 2.7)
    paths.draw(path, {"a": track}, {"net": {"a": np.full(40, 0.05)}, "other": {}})


def draw_pruning(path: Path) -> None:
    rng = np.random.default_rng(1)
    xyz, cls = rng.uniform(-20, 20, (500, 3)).astype(np.float32), rng.integers(0, 3, 500).astype(np.uint8)
    chain.draw_pruning(path, "a drive", xyz, cls, 6, 0.2)


def draw_chain(path: Path) -> None:
    rgb, depth_m, cls = street.scene(3)
    view = View(3, rgb, depth_m, cls, *cloud.pseudo_cloud(depth_m, cls, street.K, 80.0))
    angle = np.linspace(0, 5, 6)
    columns = ("driven_deg", "odometry_deg", "predicted_deg")
    steering = pd.DataFrame({"frame": range(6), "elapsed_s": angle / 10, **dict.fromkeys(columns, angle)})
    chain.draw_chain(path, view, steering, 6, 0.2)


@pytest.mark.parametrize(
    ("drawn", "pattern", "texts"),
    [
        (
            draw_wheels,
            r"(?:predicted|driven) [+-][\d.]+°",
            ["predicted +12.3°", "driven +14.0°", "predicted +0.0°", "driven +0.0°"],
        ),
        (draw_neurons, r">(\d \w+)<", ["2 features", "3 inter", "2 command", "1 motor"]),
        (draw_paths, r">(net|driven|other)<", ["driven", "net"]),  # no path of "other" in this drive
        (draw_pruning, r"(before pruning: 600 edges|after pruning)", ["before pruning: 600 edges", "after pruning"]),
        (draw_chain, r">(image|driven|odometry|predicted)<", ["image", "driven", "odometry", "predicted"]),
    ],
)  # fmt: skip
def test_a_figure_shows_its_numbers_and_repeats(
    tmp_path: Path, drawn: Callable[[Path], None], pattern: str, texts: list[str]
) -> None:
    for name in ("a", "b"):
        drawn(tmp_path / name)
    assert re.findall(pattern, (tmp_path / "a.svg").read_text()) == texts
    for suffix in ("svg", "png"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


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
