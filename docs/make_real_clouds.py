"""Draw clouds of real drives from above, from the output of `make real`.

python docs/make_real_clouds.py runs/real/data
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipeline.camera import classes
from pipeline.report import figure_file, street_view
from pipeline.show import frame_view

ROWS = (  # kind, drive, caption, frames
    ("pseudo", "2011_09_26_drive_0005", "from the image", (20, 65, 110)),
    ("lidar", "2011_09_26_drive_0005", "LiDAR, coloured by the image's classes", (20, 65, 110)),
    ("pseudo", "2011_10_03_drive_0042", "from the image, grey", (8, 25, 42)),
    ("lidar", "2011_10_03_drive_0042", "LiDAR, coloured by the image's classes", (8, 25, 42)),
)


def main(data: Path = Path("data")) -> None:
    """Draw a row of clouds for each entry of ROWS, without KITTI's images: their licence is non-commercial."""
    figure = Figure(figsize=(10, 15), layout="constrained")
    all_cls = []
    for strip, (kind, drive, caption, frames) in zip(figure.subfigures(len(ROWS)), ROWS, strict=True):
        strip.suptitle(f"{drive}, {caption}", fontsize="medium")
        for panel, frame in zip(strip.subplots(1, len(frames)), frames, strict=True):
            view, _ = frame_view.read(data / f"clouds/{kind}/{drive}.h5", frame)
            assert view.xyz is not None
            assert view.points_cls is not None
            known = view.points_cls != classes.VOID  # points outside of the image have no class
            street_view.draw_points(panel, view.xyz[known], view.points_cls[known])
            street_view.look_ahead(panel)
            panel.set_title(f"frame {frame}", fontsize="small", loc="left")
            all_cls.append(view.points_cls)
    street_view.class_legend(figure, np.concatenate(all_cls), columns=8)
    figure_file.save(figure, Path(__file__).with_name("real_clouds.png"), dpi=80)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
