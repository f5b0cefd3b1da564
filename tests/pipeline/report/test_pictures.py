"""Pictures of a frame, of charts, and of paths in an image."""

import h5py
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.camera.camera import Camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import to_units
from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.perception.perception_file import open_perception
from pipeline.report import drawings
from pipeline.report.street_view import (
    DPI,
    HALF_TRACK_M,
    HIDDEN_SHARE,
    HIDDEN_STEPS,
    STEP_M,
    WIDTH,
    chart_colour,
    draw_paths_in_image,
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
        open_ingest(tmp_path / f"ingest/{DRIVE}.h5") as raw,
        open_perception(tmp_path / f"perception/{DRIVE}.h5") as perceived,
    ):
        view = read_view(2, raw, perceived)
    np.testing.assert_array_equal(view.rgb, image)
    np.testing.assert_allclose(view.depth_m, depth_m, atol=0.01)
    np.testing.assert_array_equal(view.cls, cls)


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


def test_a_track_ends_behind_what_stands_in_front_of_it():
    """Something 10 m ahead covers the right half of the image. The other depth is unknown."""
    depth_m = np.zeros(CAMERA.size)
    depth_m[:, 160:] = 10.0
    whole = wheel_tracks(np.zeros(60), CAMERA)
    left, right = wheel_tracks(np.zeros(60), CAMERA, depth_m=depth_m)
    np.testing.assert_array_equal(left, whole[0])
    assert len(right) < len(whole[1])
    farthest_m = 100 * 1.5 / (right[-1, 1] - 40)
    assert farthest_m == pytest.approx(10 / HIDDEN_SHARE, abs=STEP_M)


def test_a_track_goes_on_behind_what_hides_few_of_its_steps():
    """Something 1 m ahead covers the pixels of some steps from the sixth on."""
    whole = wheel_tracks(np.zeros(60), CAMERA)[1]
    for hidden_steps, is_cut in ((HIDDEN_STEPS - 1, False), (HIDDEN_STEPS, True)):
        depth_m = np.zeros(CAMERA.size)
        column, row = np.rint(whole[5 : 5 + hidden_steps]).astype(int).T
        depth_m[row, column] = 1.0
        _, track = wheel_tracks(np.zeros(60), CAMERA, depth_m=depth_m)
        np.testing.assert_array_equal(track, whole[:5] if is_cut else whole)


def test_a_track_ends_where_it_turns_back_to_the_camera():
    """Half a circle of 10 m to the left: the left wheel is 9.2 m ahead, the right one 10.8 m."""
    for track, ahead_m in zip(wheel_tracks(np.full(63, 0.1), CAMERA), (9.2, 10.8), strict=True):
        assert (np.diff(track[:, 1]) < 0).all()
        assert 100 * 1.5 / (track[-1, 1] - 40) == pytest.approx(ahead_m, abs=0.1)


def test_one_of_two_coinciding_paths_is_seen_in_the_gaps_of_the_other():
    figure = Figure()
    panel = figure.add_axes((0, 0, 1, 1))
    paths = dict.fromkeys(("driven", "predicted", "without the scene"), np.zeros(40))
    draw_paths_in_image(panel, np.zeros((96, 320, 3), np.uint8), CAMERA, paths)
    styles = [line.get_linestyle() for line in panel.lines]
    assert styles == ["-", "-", "--", "--", "--", "--"]
    assert [text.get_text() for text in panel.get_legend().get_texts()] == [*paths]
    assert panel.lines[0].get_linewidth() * DPI / 72 == pytest.approx(3)
    assert WIDTH * DPI >= 800


@pytest.mark.parametrize("with_classes", [True, False])
def test_pictures_show_what_the_encoder_has(tmp_path, monkeypatch, with_classes):
    titles: list[str] = []
    monkeypatch.setattr(Axes, "set_title", lambda _, title, **style: titles.append(title))
    ingest = tmp_path / f"ingest/{DRIVE}.h5"
    perception = tmp_path / f"perception/{DRIVE}.h5"
    clouds = tmp_path / f"clouds/pseudo/{DRIVE}.h5"
    graphs = tmp_path / f"graphs/semantic/{DRIVE}.h5"
    street.write_drive(ingest.parent, DRIVE, 9)
    street.write_perception(perception.parent, ingest.parent, DRIVE)
    settings = Clouds(max_points=2048, max_depth_m=80.0, seed=0)
    clouds_drive(clouds, "pseudo", ingest, perception, settings)
    artefacts.write_graphs(graphs, np.zeros(9), np.arange(9), 80)
    if not with_classes:
        for path in (clouds, graphs, perception):
            with h5py.File(path, "a") as file:
                file["cls"][:] = VOID
    table = examples.predictions().query("drive == @DRIVE and frame < 9")
    examples.write_model(tmp_path, metrics("net"), table)
    (task,), values = examples.load(tmp_path, "net")
    chain = drawings.draw_chain(tmp_path, task, values.loc["angle-0"], tmp_path)
    assert chain.path.is_file()
    assert ("classes" in titles) == with_classes
    from_above = [title for title in titles if title.startswith("graph from above:\n80 points,")]
    assert [title.endswith("; black: no class") for title in from_above] == [not with_classes]


@pytest.mark.parametrize("depth_kind", ["true", "perceived", None])
def test_the_picture_of_a_bend_shows_the_paths_with_and_without_the_scene(
    tmp_path, monkeypatch, depth_kind
):
    """The drive turns most at frame 29, the last one. The tracks are left and right wheels'.

    The perceived depth is that of a wall 5 m ahead.
    """
    drawn: list[tuple[object, np.ndarray]] = []
    draw = Axes.plot
    street.write_drive(tmp_path / "ingest", DRIVE, 30, dense=depth_kind == "true")
    if depth_kind:
        perception = tmp_path / "perception"
        street.write_perception(perception, tmp_path / "ingest", DRIVE)
        with h5py.File(perception / f"{DRIVE}.h5", "a") as file:
            file["depth_m"][:] = to_units(np.full(file["depth_m"].shape, 5.0))
    nmse = {"path": 0.1, "path-blind": 0.6}
    for model, spatial in (("path", "gnn"), ("path-blind", "blind")):
        content = metrics(model, predict="path", spatial=spatial)
        table = examples.predictions(nmse[model], [*content["test"]]).query("drive == @DRIVE")
        examples.write_model(tmp_path, content, table)
    (task,), values = examples.load(tmp_path, *nmse)
    with open_ingest(tmp_path / f"ingest/{DRIVE}.h5") as images:
        camera = read_camera(images)
        depth_m = read_view(27, images).depth_m
    assert (depth_m is not None) == (depth_kind == "true")
    if depth_kind == "perceived":
        depth_m = np.full(camera.size, 5.0)

    def plot(panel: Axes, x: np.ndarray, y: np.ndarray, **style: object) -> None:
        drawn.append((style["color"], np.stack([x, y], axis=1)))
        draw(panel, x, y, **style)

    monkeypatch.setattr(Axes, "plot", plot)
    picture = drawings.draw_bend(tmp_path, task, values.loc["path-0"], tmp_path)
    assert picture.path.is_file()
    told = picture.caption.partition(" A path ends where something stands in front of it")[2]
    assert told == (f", by the {depth_kind} depth." if depth_kind else "")
    tracks = iter(drawn)
    for kind, error in (("driven", 0), ("predicted", 0.1), ("without the scene", 0.6)):
        steps = np.full(20, 0.27 * (1 + np.sqrt(error)))
        for expected in wheel_tracks(steps, camera, depth_m=depth_m):
            colour, track = next(tracks)
            assert colour == chart_colour(kind)
            np.testing.assert_allclose(track, expected)


def test_charts_show_the_median_and_the_worst_drive(tmp_path):
    examples.compare(tmp_path, metrics("net", [0.1, 0.4]))
    (task,), values = examples.load(tmp_path, "net")
    shown = drawings.shown_values(task, values.loc["angle-0"])
    median, worst = examples.DRIVES
    assert drawings.typical_drives(shown) == {median: "median", worst: "worst"}
