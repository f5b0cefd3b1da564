"""Pictures of a frame, of paths in an image, and of the largest errors."""

import h5py
import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Camera, read_camera
from pipeline.camera.classes import VOID
from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from pipeline.report import figures, tables
from pipeline.report.results import load_groups
from pipeline.report.street_view import (
    HALF_TRACK_M,
    STEP_M,
    path_steps,
    read_view,
    wheel_tracks,
)
from tests import artefacts, street
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics

DRIVE = examples.DRIVES[0]


def test_a_later_file_replaces_what_an_earlier_one_has(tmp_path):
    """The image of ingest; depth and classes of perception, not the ground truth beside the
    image.
    """
    street.write_drive(tmp_path / "ingest", DRIVE, 3)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    image, depth_m, cls = street.scene(2)
    with (
        DriveReader(tmp_path / f"ingest/{DRIVE}.h5", stage="ingest") as raw,
        DriveReader(tmp_path / f"perception/{DRIVE}.h5", stage="perception") as perceived,
    ):
        view = read_view(2, raw, perceived)
    np.testing.assert_array_equal(view.rgb, image)
    np.testing.assert_allclose(view.depth_m, depth_m, atol=0.01)
    np.testing.assert_array_equal(view.cls, cls)
    assert [*view.images()] == ["frame 2", "depth", "classes"]
    assert view.xyz is None


CAMERA = Camera(np.array([[100.0, 0, 160], [0, 100, 40], [0, 0, 1]]), (96, 320), 1.5)


def test_a_path_of_ranges_ends_where_its_arcs_do():
    """5 m straight on, then a quarter of a circle of 10 m to the left."""
    left, _ = wheel_tracks(path_steps([0.0, 0.1], [0, 5, 5 + 5 * np.pi]), CAMERA)
    ahead_m = 15 - HALF_TRACK_M  # of the left wheel, at last beside the middle of the track
    np.testing.assert_allclose(
        left[-1], [160 - 100 * 10 / ahead_m, 40 + 100 * 1.5 / ahead_m], atol=2
    )


def test_the_wheels_on_a_straight_road_meet_at_the_horizon():
    left, right = wheel_tracks(np.zeros(200), CAMERA)
    distance_m = STEP_M * np.arange(3, 201)  # nearer steps are not drawn
    np.testing.assert_allclose(left[:, 0], 160 - 100 * HALF_TRACK_M / distance_m)
    np.testing.assert_allclose(right[:, 0], 160 + 100 * HALF_TRACK_M / distance_m)
    np.testing.assert_allclose(left[:, 1], 40 + 100 * 1.5 / distance_m)
    uphill, _ = wheel_tracks(np.zeros(200), CAMERA, slope=-0.1)
    np.testing.assert_allclose(uphill[:, 1], left[:, 1] - 10)


@pytest.mark.parametrize("with_classes", [True, False])
def test_pictures_show_what_the_encoder_has(tmp_path, monkeypatch, with_classes):
    titles: list[str] = []
    monkeypatch.setattr(
        "matplotlib.axes.Axes.set_title", lambda _, title, **style: titles.append(title)
    )
    street.write_drive(tmp_path / "ingest", DRIVE, 9)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    clouds = tmp_path / f"clouds/pseudo/{DRIVE}.h5"
    graphs = tmp_path / f"graphs/semantic/{DRIVE}.h5"
    perception = tmp_path / f"perception/{DRIVE}.h5"
    settings = Clouds(max_points=2048, max_depth_m=80.0, seed=0)
    clouds_drive(clouds, "pseudo", tmp_path / f"ingest/{DRIVE}.h5", perception, settings)
    artefacts.write_graphs(graphs, np.zeros(9), np.arange(9), 80)
    if not with_classes:
        for path in (clouds, graphs, perception):
            with h5py.File(path, "a") as file:
                file["cls"][:] = VOID
    table = examples.predictions().query("drive == @DRIVE and frame < 9")
    examples.write_model(tmp_path, metrics("net"), table)
    groups = load_groups({"net": tmp_path / "evaluate/net"})
    (comparison,) = examples.comparisons(groups)
    chain = tmp_path / "chain.png"
    caption, views = figures.draw_chain(chain, groups[0], comparison, tmp_path)
    assert caption.startswith("From image to steering (Figure 1 of the paper): frame 8 of ")
    assert (tmp_path / "chain.png").is_file()
    assert [view.frame for view in views] == [0, 1, 2, 3, 4, 5, 6, 8]
    assert any("classes" in title for title in titles) == with_classes
    (title,) = [title for title in titles if title.startswith("graph from above: 80 points, ")]
    assert title.endswith("directed edges" if with_classes else "; black: no class")


def test_the_picture_of_a_bend_shows_the_paths_with_and_without_the_scene(tmp_path):
    """The drive turns most at frame 29, the last one."""
    street.write_drive(tmp_path / "ingest", DRIVE, 30)
    for model, spatial, nmse in (("path", "gnn", 0.1), ("path-blind", "blind", 0.6)):
        content = metrics(model, nmse, predict="path", spatial=spatial)
        table = examples.predictions(nmse, [*content["test"]]).query("drive == @DRIVE")
        examples.write_model(tmp_path, content, table)
    groups = load_groups({name: tmp_path / "evaluate" / name for name in ("path", "path-blind")})
    (comparison,) = examples.comparisons(groups)
    picture = tmp_path / "bend.png"
    caption = figures.draw_bend(picture, groups[0], comparison, tmp_path / "ingest")
    assert picture.is_file()
    assert caption.startswith(f"The path from frame 29 of {DRIVE}. Red is the path that the car ")
    assert "green the prediction of model path, and blue that of model path-blind" in caption
    paths = figures.read_paths(groups[0], comparison, "path", DRIVE, 29)
    driven, predicted, blind = (paths[kind][0] for kind in paths)
    assert [*paths] == ["driven", "predicted", "without the scene"]
    assert 0 < abs(predicted - driven) < abs(blind - driven)

    headline, *_ = tables.sentences([comparison])
    assert "Without the scene, model path-blind has 0.600. Verdict" in headline


@pytest.mark.parametrize("predict", ["angle", "path"])
def test_the_largest_error_of_a_typical_drive_is_drawn(tmp_path, monkeypatch, predict):
    """An angle is drawn as the path of a car that keeps it."""
    drawn: list[np.ndarray] = []
    monkeypatch.setattr(
        "matplotlib.axes.Axes.plot",
        lambda _, *track, **style: drawn.append(np.stack(track, axis=1)),
    )
    street.write_drive(tmp_path / "ingest", DRIVE, 30)
    for model, nmse in (("worse", 0.9), ("best", 0.0)):
        content = metrics(model, nmse, predict=predict)
        table = examples.predictions(nmse, [*content["test"]])
        row = (table["drive"] == DRIVE) & (table["frame"] == 12)
        for column in content["test"]:
            table.loc[row, f"predicted_{column}"] = 0.3
        examples.write_model(tmp_path, content, table)
    folders = {model: tmp_path / "evaluate" / model for model in ("worse", "best")}
    groups = load_groups(folders)
    (comparison,) = examples.comparisons(groups)
    captions = figures.draw_errors(tmp_path / "figures", comparison, groups[0], tmp_path / "ingest")
    driven = {"angle": "6.88 deg", "path": "68.75 deg"}[predict]
    assert captions[f"{predict}-0-worst"].startswith(
        f"Frame 12, the largest error of best in this drive: driven {driven} (red)"
    )

    # The wheels' tracks, left and right, of the driven and of the predicted path.
    with store.DriveReader(tmp_path / f"ingest/{DRIVE}.h5", stage="ingest") as images:
        camera = read_camera(images)
    expected = []
    for value in (0.12, 0.3):
        steps = {"angle": np.full(40, np.tan(value) / 2.5), "path": np.full(20, value)}[predict]
        expected += wheel_tracks(steps, camera)
    for track, expected_track in zip(drawn, expected, strict=True):
        np.testing.assert_allclose(track, expected_track)
