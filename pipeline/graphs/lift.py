"""Lift the images or scans of a drive into semantic point clouds, data/clouds/{pseudo,lidar}/<drive>.h5."""

from pathlib import Path

from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.drive_frames import open_frames
from pipeline.graphs import cloud
from pipeline.settings.clouds import Clouds


def clouds_drive(path: Path, kind: str, ingest: Path, perception: Path, settings: Clouds) -> Summary:
    """Write the cloud of each frame, back-projected with K⁻¹ (paper eq. 6, 7), or a scan in the camera frame.

    Args:
        path: of the new file.
        kind: pseudo (of images) or lidar (of scans).
        ingest, perception: the drive's files of these stages.
        settings: of section clouds.
    """
    with (
        open_frames(ingest, perception, scans=kind == "lidar") as frames,
        DriveWriter(
            path, stage="clouds", drive=frames.drive, params=frames.params | {"clouds": settings.model_dump()}
        ) as file,
    ):
        clouds = (cloud.stored_cloud(frame, kind, frames.camera, frames.drive, settings) for frame in frames)
        return cloud.write(file, frames.frame, frames.time_s, clouds)
