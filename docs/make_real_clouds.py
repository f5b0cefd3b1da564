"""Draw clouds of real drives from above, from the output of `make real`.

python docs/make_real_clouds.py runs/real/data
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipeline.base import store
from pipeline.camera import classes
from pipeline.report import street_view

DOCS = Path(__file__).resolve().parent
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
    for strip, (kind, drive, what, frames) in zip(figure.subfigures(len(ROWS)), ROWS, strict=True):
        strip.suptitle(f"{drive}, {what}", fontsize="medium")
        with store.DriveReader(data / f"clouds/{kind}/{drive}.h5", stage="clouds") as file:
            for panel, frame in zip(strip.subplots(1, len(frames)), frames, strict=True):
                start, stop = file.rows("ptr", file.row_of(frame), file.row_of(frame) + 2)
                xyz, cls = file.rows("xyz", start, stop), file.rows("cls", start, stop)
                shown = cls != classes.VOID  # points outside of the image have no class
                street_view.draw_cloud(panel, xyz[shown], cls[shown])
                panel.set_title(f"frame {frame}", fontsize="small", loc="left")
                all_cls.append(cls)
    street_view.class_legend(figure, np.concatenate(all_cls), columns=8)
    figure.savefig(DOCS / "real_clouds.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
