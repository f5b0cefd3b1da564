"""Build tables of depth, classes and motion from the metrics.json of stage scores."""

from itertools import product
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.tables import NONE, Table, number

_DEPTH = (
    "Each depth as abs rel, RMSE in metres, δ1, from 1 to 80 m: means over frames. Only pixels with a predicted depth "
    "count; coverage is their share. flat ground: a level road below the camera, with the encoder's classes, on the "
    "same pixels; an encoder that does not beat it has learned no depth. Eigen: the usual crop of KITTI."
)
_CLASSES = "Over the classes that occur in the ground truth."
_MOTION = (
    "Motion since the previous frame, measured without oxts and compared with it at or above labels.min_speed_mps; "
    "wheel: recorded steering angles; rows named …-wheel are compared with these angles. "
    "nmse: of the steering angle from the last measurement, from a drive's first measured frame on."
)


def tables(scores: dict[str, Any]) -> list[Table]:
    """Return the tables of depth, classes and motion that have rows."""
    classes = [
        {
            "split": split,
            "frames": str(row["frames"]),
            "pixel accuracy": f"{row['pixel_accuracy']:.3f}",
            "mean IoU": f"{row['mean_iou']:.3f}",
            "classes": str(len(row["iou"])),
        }
        for split in SPLITS
        if (row := scores[split]["classes"])
    ]
    motion = [
        {
            "motion": kind,
            "split": split,
            "drives": str(row["drives"]),
            "frames": str(row["frames"]),
            "measured": f"{row['valid']:.1%}",
            "compared": str(row["judged"]),
            "yaw rate RMSE deg/s": number(row["yaw_rmse_degps"], ".3f"),
            "median": number(row["yaw_median_degps"], ".3f"),
            "speed ratio": number(row["speed_ratio"], ".3f"),
            "steering nmse": number(row["nmse"], ".4f"),
        }
        for (kind, splits), split in product(scores["motion"].items(), SPLITS)
        if (row := splits[split])
    ]
    built = [
        Table("Depth", _depth(scores), _DEPTH),
        Table("Classes", classes, _CLASSES),
        Table("Motion", motion, _MOTION),
    ]
    return [table for table in built if table.rows]


def _depth(scores: dict[str, Any]) -> list[dict[str, str]]:
    sources = {"encoder": "depth", "flat ground": "ground_plane"}
    rows = []
    for split, truth in product(SPLITS, ("lidar", "dense")):
        if depth := scores[split][f"depth_{truth}"]:
            row = {"split": split, "truth": truth, "frames": str(depth["frames"])}
            row["coverage"] = f"{depth['coverage']:.1%}"
            for crop, (head, source) in product(("", "_eigen"), sources.items()):
                errors = scores[split][f"{source}_{truth}{crop}"]
                text = "{abs_rel:.3f}, {rmse_m:.2f}, {delta1:.3f}".format_map(errors) if errors else NONE
                row[f"{head}{', Eigen' if crop else ''}"] = text
            rows.append(row)
    return rows
