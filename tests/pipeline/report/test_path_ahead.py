"""Tables of models that predict the path ahead, and paired differences on the same frames."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera.camera import read_camera
from pipeline.report import figures, path_ahead
from pipeline.report.path import wheel_tracks
from pipeline.settings.evaluate import Evaluate
from stages import report
from tests import street
from tests.pipeline.report import examples

SETTINGS = Evaluate.model_validate(
    {"bootstrap_samples": 200, "bootstrap_block_frames": 5, "curvature_bins_1pm": [0.1], "path": "bicycle", "seed": 0}
)
EDGES_M = (0, 5, 10)


def errors(nmse: float, frames: int = 50) -> dict[str, Any]:
    baselines = {"zero": 1.0, "held": 0.9, "regression": 0.8}
    return {
        "frames": frames,
        "nmse": nmse,
        "nmse_std": None,
        "nmse_ci95": [nmse / 2, 2 * nmse],
        "baselines": baselines,
    }


def write(data: Path, model: str, scale: float, runs: tuple[str, ...] = (".",), rows: slice = slice(None)) -> None:
    """Write results of a model that predicts `scale` times the driven path in two drives of 30 frames."""
    content = {key: value for key, value in examples.metrics(model, predict="path").items() if key != "path"}
    ranges = [
        {"from_m": near, "to_m": far, **errors(0.4 * far / 5), "without_decisions": errors(0.3, 40)}
        for near, far in pairwise(EDGES_M)
    ]
    content |= {"train": None, "val": None, "test": ranges}
    store.write_json(data / f"evaluate/{model}/metrics.json", content)
    driven = np.sin(np.arange(30))
    table = {"frame": np.arange(30), "time_s": np.arange(30) / 10, "speed_mps": 8.0, "onset": 0, "measured_1pm": 0.0}
    for name in ("0-5", "5-10"):
        table |= {f"driven_{name}_1pm": driven, f"predicted_{name}_1pm": scale * driven}
    written = pd.concat([pd.DataFrame({"drive": drive, **table}) for drive in examples.DRIVES])
    for run in runs:
        (data / f"evaluate/{model}" / run).mkdir(exist_ok=True)
        written[rows].to_csv(data / f"evaluate/{model}" / run / "predictions.csv", index=False)


def test_the_difference_is_paired_on_common_frames(tmp_path: Path) -> None:
    """Predictions are multiples of the truth, so each error is known: (1 - scale)² of zero's."""
    write(tmp_path, "scene", 0.8, runs=(".", "seed-1"))
    write(tmp_path, "blind", 0.5, rows=slice(7, None))
    scene, blind = path_ahead.load_paths(tmp_path / "evaluate", ["scene", "blind"])
    found = path_ahead.differences(scene, blind, SETTINGS)
    assert [*found] == ["0-5", "5-10"]
    for difference in found.values():
        assert difference == pytest.approx([0.04 - 0.25] * 3)
    assert path_ahead.differences(blind, scene, SETTINGS)["0-5"].nmse == pytest.approx(0.25 - 0.04)


def test_models_without_common_frames_have_no_difference(tmp_path: Path) -> None:
    write(tmp_path, "scene", 0.8, rows=slice(0, 30))
    write(tmp_path, "blind", 0.5, rows=slice(30, 60))
    scene, blind = path_ahead.load_paths(tmp_path / "evaluate", ["scene", "blind"])
    assert np.isnan(path_ahead.differences(scene, blind, SETTINGS)["0-5"]).all()
    assert "| scene − blind |     – |      – |" in path_ahead.tables([scene, blind], SETTINGS)[2].markdown()


def test_the_report_shows_models_of_angles_and_of_paths(tmp_path: Path) -> None:
    examples.write_model(tmp_path, examples.metrics("sa-gnn-ncp"))
    write(tmp_path, "scene", 0.8)
    write(tmp_path, "blind", 0.5)
    settings = SETTINGS.model_dump()
    for models in (["sa-gnn-ncp", "scene", "blind"], ["scene"]):
        params = {"models": {name: {} for name in models}, "evaluate": settings}
        store.write_json(tmp_path / "params.yaml", params, sort_keys=False)
        report.main(tmp_path, tmp_path / "report", tmp_path / "params.yaml")
        text, page = (tmp_path / "report/table.md").read_text(), (tmp_path / "report/index.html").read_text()
        assert ("## Results" in text) == ("sa-gnn-ncp" in models)
        assert "| scene        | 0.400 (0.200 to 0.800) | 0.800 (0.400 to 1.600) |" in text
        assert "| *regression* |                  0.800 |                  0.800 |" in text
        assert ("scene − blind" in text) == ("blind" in models)
        assert "Path ahead" in page
    metrics = (tmp_path / "report/metrics.json").read_text()
    assert '"scene.nmse_5-10m": 0.8' in metrics


def test_the_largest_errors_of_the_best_model_are_drawn_on_the_street(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[str, np.ndarray]] = []
    monkeypatch.setattr(figures, "draw_path", lambda _, tracks, kind: drawn.append((kind, tracks[0])))
    street.write_drive(tmp_path / "ingest", examples.DRIVES[0], 30)
    write(tmp_path, "worse", 0.9)
    write(tmp_path, "scene", 0.8)
    content = store.read_json(tmp_path / "evaluate/worse/metrics.json", stage="evaluate")
    content["test"][0]["nmse"] = 0.9
    store.write_json(tmp_path / "evaluate/worse/metrics.json", content)
    paths = path_ahead.load_paths(tmp_path / "evaluate", ["worse", "scene"])
    turned = np.rad2deg(10 * np.sin(np.arange(30)))
    np.testing.assert_allclose(paths[1].predictions["driven_deg"], np.tile(turned, 2))
    np.testing.assert_allclose(paths[1].predictions["predicted_deg"], 0.8 * np.tile(turned, 2))
    captions = figures.draw(tmp_path / "figures", examples.results(tmp_path), paths, tmp_path)
    assert [*captions] == ["errors-path"]
    assert captions["errors-path"].startswith("Largest errors of scene, first seed")
    assert "turn in 10 m" in captions["errors-path"]
    assert (tmp_path / "figures/errors-path.png").is_file()
    assert [kind for kind, _ in drawn] == ["driven", "predicted"] * (len(drawn) // 2)
    with store.DriveReader(tmp_path / f"ingest/{examples.DRIVES[0]}.h5", stage="ingest") as images:
        camera = read_camera(images)
    frame = int(np.abs(turned).argmax())
    (_, driven), (_, predicted) = drawn[:2]
    for tracks, scale in ((driven, 1.0), (predicted, 0.8)):
        steps = np.full(20, scale * np.sin(frame))
        np.testing.assert_allclose(tracks, wheel_tracks(steps, camera)[0])


@pytest.mark.parametrize("column", ["frame", "predicted_5-10_1pm"])
def test_damaged_predictions_name_the_command(tmp_path: Path, column: str) -> None:
    write(tmp_path, "scene", 0.8)
    path = tmp_path / "evaluate/scene/predictions.csv"
    path.write_text(path.read_text().replace(column, "other"))
    with pytest.raises(InputError, match=r"predictions\.csv.*evaluate@scene") as raised:
        path_ahead.load_paths(tmp_path / "evaluate", ["scene"])
    assert "\n" not in str(raised.value)
