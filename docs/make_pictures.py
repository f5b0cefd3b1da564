"""Draw README's moving picture and the frames of the sample, from the data of `make demo`.

    python -m docs.make_pictures path      # docs/path.webp
    python -m docs.make_pictures sample    # docs/sample.png
    python -m docs.make_pictures street    # docs/street.png, after the command of docs/measure.md

The moving picture shows a test road. It is the one with the median difference in the error that
leads, the displacement at 20 m, between the best network and the best one without the scene. The
picture begins with the first frame whose driven path turns, with a radius below 135 m.
"""

import io
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure
from PIL import Image

from pipeline.jobs import console

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import load_section, read_entries
from pipeline.camera.camera import Camera
from pipeline.evaluate.error_table import frame_errors, is_turning
from pipeline.evaluate.settings import Evaluate
from pipeline.graphs.graph_file import open_graphs
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.perception.perception_file import open_perception
from pipeline.report import drawings, street_view
from pipeline.report.values import Task, gather_values, lead_label, load_tasks

DOCS = Path(__file__).parent
# Size of the moving picture in inches.
SIZE = (6.0, 4.3)
# Duration in milliseconds of a frame of the moving picture, which shows a drive at half its speed.
DURATION_MS = 200
# Quality of the moving picture's compression, from 0 to 100.
QUALITY = 60
# Panel of the moving picture → position: left, bottom, width and height, as shares of the picture.
PANELS = {
    "1  image, and the path": (0.005, 0.545, 0.99, 0.415),
    "2  depth from the image": (0.005, 0.275, 0.49, 0.205),
    "3  classes from the image": (0.005, 0.005, 0.49, 0.205),
    "4  graph and path from above": (0.58, 0.09, 0.41, 0.39),
}

Data = Annotated[Path, typer.Option(help="folder with the folders of all stages")]


def path(
    data: Data = Path("data"),
    params: Path = Path("params.yaml"),
    out: Path = DOCS / "path.webp",
) -> None:
    """Draw the frames of a test road with the paths, as a moving picture."""
    models = read_entries("models", params)
    tasks = load_tasks({name: data / "evaluate" / name for name in models})
    values = gather_values(tasks, load_section(Evaluate, params))
    task = tasks[0]
    table = values.loc[task.name]
    drive = choose_drive(task, table)

    variant = task.models[drawings.curve_kinds(table)["predicted"]]["entry"]["input"]
    pictures = []
    with ExitStack() as stack:
        images = stack.enter_context(open_ingest(data / f"ingest/{drive}.h5"))
        perceived = stack.enter_context(open_perception(data / f"perception/{drive}.h5"))
        graphs = stack.enter_context(open_graphs(data / f"graphs/{variant}/{drive}.h5"))
        camera = read_camera(images)
        for frame in turning_frames(task, drive).itertuples():
            view = street_view.read_view(frame.frame, images, perceived, graphs)
            paths = drawings.read_paths(task, table, drive, frame.frame)
            # The depth that hides paths is the true one where the images have it.
            depth_m = street_view.read_view(frame.frame, perceived, images).depth_m
            pictures.append(draw_frame(view, camera, paths, depth_m, frame.time_s))
    first, *others = pictures
    first.save(
        out,
        save_all=True,
        append_images=others,
        duration=DURATION_MS,
        loop=0,
        quality=QUALITY,
        method=6,
    )
    print(f"{out}: {len(pictures)} frames of {drive}, {out.stat().st_size / 1e6:.1f} MB")


def choose_drive(task: Task, table: pd.DataFrame) -> str:
    """Return the test drive with the median difference in the error that leads.

    The difference is that of the best network from the best one without the scene, as the mean over
    frames and seeds. Of an even number of drives, it is the one above the middle.
    """
    kinds = drawings.curve_kinds(table)
    if "without the scene" not in kinds:
        raise InputError("no model without the scene", fix="Add one to models, and run dvc repro")
    label = lead_label(table)
    predictions = task.predictions
    errors = []
    for kind in ("predicted", "without the scene"):
        of_frames = frame_errors(predictions, kinds[kind])[label].error  # [S,N,C]
        errors.append(of_frames.mean(axis=(0, 2)))
    difference = pd.Series(errors[0] - errors[1])
    by_drive = difference.groupby(predictions.frames["drive"]).mean().dropna()
    drives = by_drive.sort_values(kind="stable").index
    return str(drives[len(drives) // 2])


def turning_frames(task: Task, drive: str) -> pd.DataFrame:
    """Return the frames of a drive from the first one that turns, with time_s since its start."""
    predictions = task.predictions
    frames = predictions.frames
    of_drive = frames["drive"] == drive
    counted = of_drive & np.isfinite(predictions.truth).all(axis=1)
    turns = counted & is_turning(predictions.quantity, predictions.truth)
    first = turns.idxmax() if turns.any() else counted.idxmax()
    shown = frames[counted & (frames.index >= first)]
    return shown.assign(time_s=shown["time_s"] - frames.loc[of_drive, "time_s"].min())


def draw_frame(
    view: street_view.View,
    camera: Camera,
    paths: dict[str, np.ndarray],
    depth_m: np.ndarray | None,
    time_s: float,
) -> Image.Image:
    """Return a frame of the moving picture.

    `paths` is kind → curvature of each step. They end where the depth [H,W] hides them.
    """
    figure = Figure(figsize=SIZE, dpi=street_view.DPI)
    panels = [figure.add_axes(place) for place in PANELS.values()]
    _, *perceived = view.images().values()
    street_view.draw_paths_in_image(panels[0], np.asarray(view.rgb), camera, paths, depth_m)
    street_view.write_in_image(panels[0], f"{time_s:.1f} s")
    for panel, pixels in zip(panels[1:3], perceived, strict=True):
        panel.imshow(pixels, interpolation="nearest")
        panel.set_axis_off()
    street_view.draw_points(panels[3], view)
    street_view.draw_paths_from_above(panels[3], paths)
    for panel, title in zip(panels, PANELS, strict=True):
        panel.set_title(title, loc="left", fontsize="small", pad=3)
    panels[3].tick_params(labelsize="x-small")
    panels[3].xaxis.label.set_fontsize("x-small")
    panels[3].yaxis.label.set_fontsize("x-small")

    png = io.BytesIO()
    figure.savefig(png, format="png")
    return Image.open(png).convert("RGB")


def sample(data: Data = Path("data"), out: Path = DOCS / "sample.png") -> None:
    """Draw the middle frame of each validation drive: image, true depth and true classes."""
    splits = store.read_index(data / "ingest", stage="ingest")
    drives = store.drives_in(splits, "val")
    figure = Figure(figsize=(6.8, 0.69 * len(drives) + 0.25))
    figure.subplots_adjust(0, 0, 1, 1 - 0.25 / figure.get_figheight(), 0.01, 0.03)
    rows = figure.subplots(len(drives), 3, squeeze=False)
    for row, drive in zip(rows, drives, strict=True):
        with open_ingest(data / f"ingest/{drive}.h5") as file:
            frames = file.frame[file["has_image"] > 0]
            view = street_view.read_view(frames[len(frames) // 2], file)
        for panel, pixels in zip(row, view.images().values(), strict=True):
            panel.imshow(pixels, interpolation="bilinear")
            panel.set_axis_off()
    titles = ["image", f"depth: red {street_view.NEAR_M:g} m, blue {street_view.FAR_M:g} m"]
    for panel, title in zip(rows[0], [*titles, "classes"], strict=True):
        panel.set_title(title, loc="left", fontsize="small")
    street_view.save_figure(figure, out)
    print(f"{out}: {len(drives)} drives, {out.stat().st_size / 1e6:.1f} MB")


def street(
    measured: Path = Path("out/udacity/motion.csv"), out: Path = DOCS / "street.png"
) -> None:
    """Draw the measured steering angle of the clip of a real street beside that of its log."""
    table = pd.read_csv(measured)
    figure = Figure(figsize=(6.8, 2.6), layout="constrained")
    panel = figure.subplots()
    for column, kind, name in (
        ("driven_rad", "driven", "log of the steering wheel, divided by the steering ratio"),
        ("measured_rad", "predicted", "measured in the images"),
    ):
        angle_deg = np.degrees(table[column])
        panel.plot(table["time_s"], angle_deg, color=street_view.chart_colour(kind), label=name)
    panel.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    panel.set(xlabel="time in s", ylabel="angle of the front wheels\nin degrees, left positive")
    figure.legend(loc="outside upper left", ncols=2, frameon=False)
    street_view.save_figure(figure, out)
    print(f"{out}: {len(table)} frames")


if __name__ == "__main__":
    console.run(path, sample, street)
