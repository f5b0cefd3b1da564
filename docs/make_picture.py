"""Draw README's moving picture, docs/path.webp, from the results of `make demo`.

    python -m docs.make_picture

Each frame of a test drive is shown from the image to the path: depth and classes of the image, its
graph from above, and the driven path beside those that networks predict with and without the scene.
The drive is that of the picture at the top of the page.
"""

import io
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.figure import Figure
from PIL import Image

from pipeline.base import store
from pipeline.base.params import entries, load
from pipeline.camera.camera import Camera, read_camera
from pipeline.evaluate.settings import Evaluate
from pipeline.report import figures, street_view, summary
from pipeline.report.results import load_groups
from pipeline.report.summary import Comparison

# Size of the picture in inches.
SIZE = (10.0, 5.0)
# Pixels per inch.
DPI = 88
# Duration of a frame in milliseconds. The drive is shown at half of its speed.
DURATION_MS = 200
# Quality of the compression, from 0 to 100.
QUALITY = 70
# Position of each panel: left, bottom, width and height, as shares of the picture.
PANELS = {
    "image": (0.01, 0.67, 0.49, 0.28),
    "depth": (0.01, 0.34, 0.49, 0.28),
    "classes": (0.01, 0.01, 0.49, 0.28),
    "graph": (0.57, 0.09, 0.42, 0.85),
}


def main(
    data: Annotated[Path, typer.Option(help="folder with the folders of all stages")] = Path(
        "data"
    ),
    params: Path = Path("params.yaml"),
    out: Path = Path("docs/path.webp"),
) -> None:
    """Draw the frames of a test drive, and write them as an animated picture."""
    groups = load_groups({name: data / "evaluate" / name for name in entries("models", params)})
    group = groups[0]
    comparison = Comparison(summary.results(groups, load(Evaluate, params), {}), group.key)
    model = comparison.by_error[0]
    predictions = group.first_seed(model)
    drive, _ = figures.median_bend(predictions)
    counted = predictions[(predictions["drive"] == drive) & predictions["cost"].notna()]

    variant = group.models[model]["entry"]["input"]
    folders = {"ingest": "ingest", "perception": "perception", "graphs": f"graphs/{variant}"}
    pictures = []
    with ExitStack() as stack:
        files = {}
        for stage, folder in folders.items():
            path = data / folder / f"{drive}.h5"
            files[stage] = stack.enter_context(store.DriveReader(path, stage=stage))
        camera = read_camera(files["ingest"])
        for frame in counted["frame"].tolist():
            view = street_view.read_view(frame, *files.values())
            paths = figures.read_paths(group, comparison, model, drive, frame)
            pictures.append(_draw(view, camera, paths))
    first, *others = pictures
    first.save(
        out, save_all=True, append_images=others, duration=DURATION_MS, loop=0, quality=QUALITY
    )
    print(f"{out}: {len(pictures)} frames of {drive}, {out.stat().st_size / 1e6:.1f} MB")


def _draw(view: street_view.View, camera: Camera, paths: dict[str, np.ndarray]) -> Image.Image:
    """Return the picture of a frame. `paths` is kind → curvature of each step."""
    figure = Figure(figsize=SIZE, dpi=DPI)
    panels = {name: figure.add_axes(place) for name, place in PANELS.items()}
    _, *perceived = view.images().items()
    street_view.draw_paths_in_image(panels["image"], np.asarray(view.rgb), camera, paths)
    for name, pixels in perceived:
        street_view.draw_image(panels[name], pixels, "")
    street_view.draw_points(panels["graph"], view)
    street_view.draw_paths_from_above(panels["graph"], paths)
    panels["graph"].legend(loc="upper right", fontsize="small")

    titles = {
        "image": "1  image, and the path",
        "depth": "2  depth from the image",
        "classes": "3  classes from the image",
        "graph": f"4  graph of {len(np.asarray(view.xyz)):,} points, and the path",
    }
    for name, title in titles.items():
        panels[name].set_title("")  # the title in the middle, which draw_points sets
        panels[name].set_title(title, loc="left", fontsize="medium")

    png = io.BytesIO()
    figure.savefig(png, format="png")
    return Image.open(png).convert("RGB")


if __name__ == "__main__":
    typer.run(main)
