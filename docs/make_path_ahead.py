"""Draw the path into a bend: driven, and predicted by a network of the path ahead, on a frame of a validation drive.

python docs/make_path_ahead.py data path-polar 2026_01_02_drive_0001 16
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base.params import load
from pipeline.base.store import DriveReader
from pipeline.camera.camera import read_camera
from pipeline.graphs import graph_file
from pipeline.report import figure_file
from pipeline.report.figures import draw_path
from pipeline.report.path import COLOURS, STEP_M, follow, path_steps, wheel_tracks
from pipeline.sample.drive import Drive
from pipeline.settings.sample import Sample
from pipeline.train import predict
from pipeline.train.labelled_drive import read_drive

SIZE = 432, 1440  # of the picture, [H, W]; the network gets the images of stage ingest


def main(data: str, model: str, drive: str, number: str) -> None:
    """Draw both paths on the street and from above; `data` holds the stages' folders."""
    trained, frame = predict.load(Path(data) / "train" / model, "cpu"), int(number)
    variant = Path(data) / "graphs" / trained.entry.input
    labelled = read_drive(variant, Path(data) / "labels", drive, **trained.entry.reading)
    with graph_file.open_graphs(labelled.graphs) as graphs:
        (predicted,) = trained.predict(graphs, [frame])
    (driven,) = labelled.path_1pm[labelled.rows([frame])]
    with DriveReader(Path(data) / f"ingest/{drive}.h5", stage="ingest") as file:
        camera = read_camera(file).scaled(SIZE)
    figure = Figure(figsize=(11, 2.9), layout="constrained")
    street, above = figure.subplots(1, 2, width_ratios=[4.6, 1])
    street.imshow(render(drive, frame))
    street.set_axis_off()
    for kind, path_1pm in (("driven", driven), ("predicted", predicted)):
        steps = path_steps(path_1pm, labelled.ahead_m, STEP_M)
        draw_path(street, wheel_tracks(steps, camera), kind)
        draw_from_above(above, steps, kind)
    above.set(xlabel="right in m", ylabel="ahead in m", aspect="equal")
    above.legend(frameon=False, fontsize="small")
    figure_file.save(figure, Path(__file__).with_name("path_ahead.png"))


def draw_from_above(panel: Axes, steps_1pm: np.ndarray, kind: str) -> None:
    """Draw the path of curvatures [N] from above."""
    places, _ = follow(steps_1pm, STEP_M)
    panel.plot(-places.imag, places.real, color=[value / 255 for value in COLOURS[kind]], label=kind)


def render(drive: str, frame: int) -> np.ndarray:
    """Render a drive of the sample in SIZE; return the frame's image, uint8 [H,W,3]."""
    settings = load(Sample, Path("params.yaml"))
    rendered = Drive(drive, frames=settings.frames.val, size=SIZE, scan_rays=(1, 1), seed=settings.seed)
    with TemporaryDirectory() as folder:
        rendered.write(Path(folder) / drive)
        image = cv2.imread(str(Path(folder) / drive / f"image_02/data/{frame:010d}.png"))
    return image[..., ::-1]


if __name__ == "__main__":
    main(*sys.argv[1:])
