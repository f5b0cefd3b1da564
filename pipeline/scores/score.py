"""Score the perceived images of a drive, and perceived images and measured motion of a split."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.base.store import drives_in, write_json
from pipeline.base.summary import Summary
from pipeline.camera.images import to_metres
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.ingest.truth import read_truth
from pipeline.labels.label import Car
from pipeline.motion.motion_file import open_motion
from pipeline.perception.perception_file import open_perception
from pipeline.scores.motion_scores import score_motion
from pipeline.scores.pixels import Scores
from pipeline.scores.recorded import Facts, Recorded, compare_drives


def score_drive(path: Path, *, ingest: Path, perception: Path) -> Summary:
    """Write the scores of a drive, DRIVE/metrics.json, and return the sums of its errors.

    The sums are those of :class:`Scores`, so they can be added to those of other drives. `ingest`
    and `perception` are the drive's files of these stages.
    """
    scores = Scores()
    with (
        open_ingest(ingest) as source,
        open_perception(perception) as perceived,
    ):
        camera = read_camera(source)
        for row, number in enumerate(perceived.frame):
            depth_m = to_metres(perceived.row("depth_m", row))
            cls = perceived.row("cls", row)
            truth = read_truth(source, camera, source.row_of(number))
            scores.add_frame(depth_m, cls, camera, truth)
    write_json(path, scores.to_report())
    sums = {key: values.tolist() for key, values in scores.sums.items()}
    return {"frames": len(perceived.frame), "sums": sums}


def score_splits(
    splits: Mapping[str, str],
    summaries: Mapping[str, Summary],
    ingest: Path,
    motion: Path,
    car: Car,
) -> dict[str, Any]:
    """Return the scores of the validation and test drives, and facts about recorded motion.

    Scores of training drives are None, since these drives are not scored. Recorded motion is
    compared with measured motion in the training and validation drives. The lines of test drives
    are their own and advise no offset, which would align their truth with odometry.

    Args:
        splits: drive → split, for all drives.
        summaries: drive → result of :func:`score_drive`, for the drives that are scored.
        ingest: folder of stage ingest.
        motion: folder of stage motion.
        car: parameters of the steering angle.
    """
    content: dict[str, Any] = {"motion": dict.fromkeys(SPLITS), "train": Scores().to_report()}
    for split in ("val", "test"):
        scores = Scores()
        drives = drives_in(splits, split)
        for drive in drives:
            scores.add_sums(summaries[drive]["sums"])
        content[split] = scores.to_report()
        content["motion"][split] = score_motion(drives, ingest, motion, car)

    content["recorded"] = _compare_logs(splits, ingest, motion, car)
    return content


def _compare_logs(splits: Mapping[str, str], ingest: Path, motion: Path, car: Car) -> Facts:
    """Return facts about the logs of training and validation drives, then of test drives."""
    content: Facts = {}
    groups = {
        "training and validation drives": drives_in(splits, "train", "val"),
        "test drives": drives_in(splits, "test"),
    }
    for name, drives in groups.items():
        recorded = {}
        for drive in drives:
            with (
                open_ingest(ingest / f"{drive}.h5") as raw,
                open_motion(motion / f"{drive}.h5") as measured,
            ):
                # A drive without images has no measured motion.
                if len(measured.frame):
                    recorded[drive] = Recorded.read(raw, measured, car)
        if recorded:
            content |= compare_drives(recorded, name, advise=name != "test drives")
    return content
