"""Recognise drives of KITTI-360 and of the odometry benchmark, whose layout is not KITTI raw's."""

from pathlib import Path

# Cameras of the odometry benchmark, in order of preference: colour, then grey.
_CAMERAS = (2, 3, 0, 1)


def find_other_layout(folder: Path) -> str:
    """Return what is in a folder, or up to three folders below, and what to do about it.

    The text is empty if there is neither a drive of KITTI-360 nor a sequence of the benchmark.
    """
    for below in ("", "*/", "*/*/", "*/*/*/"):
        for images in sorted(folder.glob(f"{below}image_0[01]/data_rect")):
            number = images.parent.name[-2:]
            return (
                f"Found {images}: images of KITTI-360, which has another layout. "
                "Pass them to steer measure or steer import with --fps 10 and --K FX,FY,CX,CY "
                f"(P_rect_{number} in perspective.txt)"
            )
        for calibration in sorted(folder.glob(f"{below}calib.txt")):
            sequence = calibration.parent
            for camera in _CAMERAS:
                images = sequence / f"image_{camera}"
                if images.is_dir():
                    return (
                        f"Found {images}: images of the odometry benchmark, which has no oxts. "
                        "KITTI raw has the same drives with oxts. Or pass the images to steer "
                        f"measure or steer import with --times {sequence}/times.txt and "
                        f"--K FX,FY,CX,CY (P{camera} in calib.txt)"
                    )
    return ""
