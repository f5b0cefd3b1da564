"""Read the frames of a drive with what stages ingest and perception have of them."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from pipeline.camera.camera import Frame
from pipeline.camera.images import to_metres
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.perception.perception_file import open_perception


class DriveFrames(ExitStack):
    """The frames of a drive that have an image, or with `scans` those that have a scan.

    This is a context manager that opens the drive's files of stages ingest and perception. Frames
    of both files are matched by their numbers.
    """

    def __init__(self, ingest: Path, perception: Path, *, scans: bool = False) -> None:
        super().__init__()
        self._ingest = self.enter_context(open_ingest(ingest))
        self._perception = self.enter_context(open_perception(perception))
        self._scans = scans

        # Stage ingest lists the frames with a scan, stage perception those with an image.
        self.frame = self._perception.frame  # KITTI frame numbers, int32 [F]
        self.time_s = self._perception.time_s  # float64 [F]
        if scans:
            rows = np.flatnonzero(self._ingest["has_lidar"])
            self.frame = self._ingest.frame[rows]
            self.time_s = self._ingest.time_s[rows]

        self.drive = self._ingest.drive
        self.params = self._perception.params
        self.camera = read_camera(self._ingest)
        # Largest plausible factor between the camera's known height and its height by depth. Depth
        # beyond it is in another unit.
        self.unit_error = float(self._perception.attrs.get("unit_error", np.inf))

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames with image, depth and classes, or with a scan and classes of its image.

        A frame with a scan may lack an image, and so classes.
        """
        image_row = {number: row for row, number in enumerate(self._perception.frame.tolist())}
        for number, time_s in zip(self.frame.tolist(), self.time_s.tolist(), strict=True):
            frame = Frame(number, time_s)
            ingest_row = self._ingest.row_of(number)
            if number in image_row:
                frame.cls = self._perception.row("cls", image_row[number])
            if self._scans:
                frame.scan = self._ingest.rows_of("lidar", ingest_row)
            else:
                frame.image = self._ingest.row("image", ingest_row)
                frame.depth_m = to_metres(self._perception.row("depth_m", image_row[number]))
            yield frame
