"""Frames of one drive from the files of stages ingest and perception, matched by frame number."""

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera.camera import Frame, read_camera
from pipeline.camera.images import to_metres


class DriveFrames:
    """The frames of a drive that have an image, or with `scans` those that have a scan."""

    def __init__(self, ingest: DriveReader, perception: DriveReader, *, scans: bool) -> None:
        self._ingest, self._perception = ingest, perception
        self._scan_rows = np.flatnonzero(ingest["has_lidar"]) if scans else None
        source, rows = (perception, slice(None)) if self._scan_rows is None else (ingest, self._scan_rows)
        self.drive, self.params = ingest.drive, perception.params
        self.frame = source.frame[rows]  # KITTI frame numbers, int32 [F]
        self.time_s = source.time_s[rows]  # float64 [F]
        self.camera = read_camera(ingest, float(perception.attrs["camera_height_m"]))

    def __iter__(self) -> Generator[Frame]:
        """Yield frames with image, depth and classes; or with a scan, and classes where there is an image."""
        image_row = {int(number): row for row, number in enumerate(self._perception.frame)}
        ingest_row = {int(number): row for row, number in enumerate(self._ingest.frame)}
        for number, time_s in zip(self.frame.tolist(), self.time_s.tolist(), strict=True):
            frame, raw_row, row = Frame(number, time_s), ingest_row[number], image_row.get(number)
            if row is not None:
                frame.cls = self._perception.row("cls", row)
            if self._scan_rows is not None:
                frame.scan = self._ingest.rows_of("lidar", raw_row)
            elif row is not None:
                frame.image = self._ingest.row("image", raw_row)
                frame.depth_m = to_metres(self._perception.row("depth_m", row))
            yield frame


@contextmanager
def open_frames(ingest: Path, perception: Path, *, scans: bool = False) -> Iterator[DriveFrames]:
    """Open the frames of a drive from its files of stages ingest and perception."""
    with DriveReader(ingest, stage="ingest") as raw, DriveReader(perception, stage="perception") as perceived:
        yield DriveFrames(raw, perceived, scans=scans)
