"""The paper's figures: of which frames, with what in them, in two formats, the same bytes each time."""

import re
from pathlib import Path

import numpy as np

from pipeline.report.figures import neurons, paths, pruning, wheels
from pipeline.report.judge.paths import Track


def written(path: Path) -> dict[str, bytes]:
    return {kind: path.with_suffix(f".{kind}").read_bytes() for kind in ("png", "svg")}


def test_frames_are_chosen_by_what_is_predicted() -> None:
    predicted = np.array([np.nan, 2.0, 11.0, -3.1, -10.0, -0.2, 5.0])
    assert wheels.chosen(predicted) == {"left": 2, "slight right": 3, "sharp right": 4, "straight": 5}
    assert wheels.chosen(np.array([1.0, 4.0])) == {"left": 1, "straight": 0}
    assert wheels.chosen(np.array([np.nan])) == {}


def test_wheels_say_both_angles(tmp_path: Path) -> None:
    image = np.zeros((40, 120, 3), np.uint8)
    shown = [wheels.Shown("left: a, 3", image, 12.34, 14.0), wheels.Shown("straight: a, 9", image, -0.01, 0.0)]
    for _ in range(2):
        wheels.draw(tmp_path / "wheels", "net", shown)
        made = written(tmp_path / "wheels")
        (tmp_path / "first").mkdir(exist_ok=True)
    text = made["svg"].decode()
    assert re.findall(r"(?:predicted|driven) [+-][\d.]+°", text) == [
        "predicted +12.3°", "driven +14.0°", "predicted +0.0°", "driven +0.0°"
    ]  # fmt: skip
    wheels.draw(tmp_path / "again", "net", shown)
    assert written(tmp_path / "again") == made


def test_a_hundred_points_have_six_hundred_edges(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    xyz, cls = rng.uniform(-20, 20, (500, 3)).astype(np.float32), rng.integers(0, 3, 500).astype(np.uint8)
    pruning.draw(tmp_path / "pruning", "a drive", xyz, cls, 6, 0.2)
    text = written(tmp_path / "pruning")["svg"].decode()
    before, after = map(int, re.findall(r"(?:before|after) pruning: (\d+) edges", text))
    assert before == 600
    assert 0.3 * before < after < 0.7 * before  # a third is within a class, and a fifth of the rest stays


def test_paths_of_models_lie_beside_the_driven_one(tmp_path: Path) -> None:
    time_s = np.arange(40) / 10
    track = Track(time_s, np.full(40, 8.0), np.zeros(40), np.array([20]), 2.7)
    models = {"net": {"a": np.full(40, 0.05)}, "other": {}}
    paths.draw(tmp_path / "paths", {"a": track}, models)
    text = written(tmp_path / "paths")["svg"].decode()
    assert text.count(">net<") == 1
    assert ">driven<" in text
    assert ">other<" not in text  # it was not judged by this drive


def test_neurons_stand_as_signals_go(tmp_path: Path) -> None:
    wiring = {"motor": 1, "command": 2, "inter": 3, "sensory": [[0, 3, 1], [1, 5, -1]]}
    wiring["internal"] = [[3, 1, 1], [4, 2, -1], [1, 2, 1], [2, 0, 1]]
    activity = np.linspace(-1, 1, 24).reshape(4, 6).tolist()
    steering = [0.1, None, 0.2, 0.3]
    told = {"wiring": wiring, "drive": "a", "frame": [3, 4, 5, 6], "steering_rad": steering, "activity": activity}
    neurons.draw(tmp_path / "neurons", "net", told)
    text = written(tmp_path / "neurons")["svg"].decode()
    assert re.findall(r">(\d \w+)<", text) == ["2 features", "3 inter", "2 command", "1 motor"]
    neurons.draw(tmp_path / "again", "net", told)
    assert written(tmp_path / "again") == written(tmp_path / "neurons")
