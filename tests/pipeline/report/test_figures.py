"""Pictures of the page: which frames, and their numbers."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base import store
from pipeline.camera.camera import read_camera
from pipeline.camera.classes import VOID
from pipeline.graphs.cloud import clouds_drive
from pipeline.report import figures
from pipeline.report.path import wheel_tracks
from pipeline.report.results import load_groups
from pipeline.settings.clouds import Clouds
from tests import street
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics

DRIVE, OTHER = examples.DRIVES


@pytest.mark.parametrize("with_classes", [True, False])
def test_pictures_show_what_the_encoder_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_classes: bool
) -> None:
    titles: list[str] = []
    monkeypatch.setattr("matplotlib.axes.Axes.set_title", lambda _, title, **style: titles.append(title))
    street.write_drive(tmp_path / "ingest", DRIVE, 9)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    files = [tmp_path / f"{stage}/{DRIVE}.h5" for stage in ("clouds/pseudo", "ingest", "perception")]
    clouds_drive(files[0], "pseudo", *files[1:], Clouds(max_points=2048, max_depth_m=80.0, seed=0))
    if not with_classes:
        for name in (f"perception/{DRIVE}.h5", f"clouds/pseudo/{DRIVE}.h5"):
            with h5py.File(tmp_path / name, "a") as file:
                file["cls"][:] = VOID
    table = examples.predictions(0.01).query("drive == @DRIVE and frame < 9")
    examples.write_model(tmp_path, metrics("without", 0.1) | {"variant": {}}, table)
    examples.write_model(tmp_path, metrics("net"), table)
    captions = figures.draw(tmp_path / "figures", load_groups(tmp_path / "evaluate", ["without", "net"]), tmp_path)
    assert "of net, which" in captions["chain"]
    assert [*captions] == ["chain", "errors-angle-0"]
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {f"{name}.png" for name in captions}
    assert any("classes" in title for title in titles) == with_classes
    (edges,) = [title for title in titles if "directed edges" in title]
    assert (" of 1,800 " in edges) == with_classes


@pytest.mark.parametrize("predict", ["angle", "path"])
def test_the_largest_errors_of_the_best_model_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, predict: str
) -> None:
    drawn: list[tuple[str, np.ndarray]] = []
    monkeypatch.setattr(figures, "draw_path", lambda _, tracks, kind: drawn.append((kind, tracks[0])))
    street.write_drive(tmp_path / "ingest", DRIVE, 30)
    columns = examples.PATH if predict == "path" else examples.ANGLE
    for model, nmse in (("worse", 0.9), ("best", 0.2)):
        table = examples.predictions(0.0, columns)
        for column in columns:
            table.loc[(table["drive"] == DRIVE) & (table["frame"] == 12), f"predicted_{column}"] = 0.3
        examples.write_model(tmp_path, metrics(model, nmse, predict=predict), table)
    captions = figures.draw(tmp_path / "figures", load_groups(tmp_path / "evaluate", ["worse", "best"]), tmp_path)
    assert [*captions] == [f"errors-{predict}-0"]
    assert captions[f"errors-{predict}-0"].startswith("Largest errors of best")
    if predict == "path":
        with store.DriveReader(tmp_path / f"ingest/{DRIVE}.h5", stage="ingest") as images:
            camera = read_camera(images)
        for (kind, track), curvature_1pm in zip(drawn, (0.12, 0.3), strict=True):
            assert kind == ("driven" if curvature_1pm == 0.12 else "predicted")
            np.testing.assert_allclose(track, wheel_tracks(np.full(20, curvature_1pm), camera)[0])


def test_shares_of_the_largest_errors_count_each_frame_once() -> None:
    table = examples.predictions(0.0).assign(true_deg=0.0, predicted_deg=0.0, elapsed_s=lambda rows: rows["frame"] / 10)
    first, frame = table["drive"] == DRIVE, table["frame"]
    for number, error in ((10, 3.0), (16, 1.0), (25, -2.0)):  # 16 is within a second of both others
        table.loc[first & (frame == number), "predicted_deg"] = error
    table.loc[~first & (frame == 10), "predicted_deg"] = 2.5
    found = figures.largest_errors(table)
    assert found[["drive", "frame"]].to_numpy().tolist() == [[DRIVE, 10], [OTHER, 10], [DRIVE, 25]]
    np.testing.assert_allclose(found["share"] * 20.25, [10, 6.25, 4])
    assert found["share"].sum() == pytest.approx(1)
