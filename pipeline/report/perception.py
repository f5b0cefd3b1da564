"""Build tables and metrics of depth, classes and motion from the metrics.json of stage scores."""

from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base import store
from pipeline.base.params import SPLITS
from pipeline.evaluate.schema import Count, Form, Number
from pipeline.report.tables import NONE, Table, cells

_DEPTH = (
    "Each depth as abs rel, RMSE in metres, δ1, from 1 to 80 m: means over frames. Only pixels with a predicted depth "
    "count; coverage is their share. flat ground: a level road below the camera, with the encoder's classes, on the "
    "same pixels; an encoder that does not beat it has learned no depth. Eigen: the usual crop of KITTI."
)
_MOTION = (
    "Motion since the previous frame, measured without oxts and compared with it at or above labels.min_speed_mps; "
    "wheel: recorded steering angles; rows named …-wheel are compared with these angles. "
    "nmse: of the steering angle from the last measurement, from a drive's first measured frame on. Drives without "
    "scans count for visual only."
)


class _Form(Form, extra="ignore"):
    """A JSON object of which the report uses some keys."""


class _Depth(_Form):
    frames: Count
    coverage: Number
    abs_rel: Number
    rmse_m: Number
    delta1: Number


class _Classes(_Form):
    frames: Count
    pixel_accuracy: Number
    mean_iou: Number
    iou: dict[str, Number]


class _Motion(_Form):
    drives: Count
    frames: Count
    judged: Count
    valid: Number
    yaw_rmse_degps: Number | None
    yaw_median_degps: Number | None
    speed_ratio: float | None
    nmse: Number | None


class _Split(_Form):
    classes: _Classes | None
    depth_dense: _Depth | None
    depth_dense_eigen: _Depth | None
    depth_lidar: _Depth | None
    depth_lidar_eigen: _Depth | None
    ground_plane_dense: _Depth | None
    ground_plane_dense_eigen: _Depth | None
    ground_plane_lidar: _Depth | None
    ground_plane_lidar_eigen: _Depth | None


class _MotionBySplit(_Form):
    train: _Motion | None
    val: _Motion | None
    test: _Motion | None


class Scores(_Form):
    """Contents of the metrics.json of stage scores; `motion` by kind."""

    train: _Split
    val: _Split
    test: _Split
    motion: dict[str, _MotionBySplit] = {}


def load_scores(folder: Path) -> dict[str, Any] | None:
    """Load the metrics.json of stage scores; None if there is none, as on a machine that only trains."""
    path = folder / "metrics.json"
    return Scores(**store.read_json(path, stage="scores", form=Scores)).model_dump() if path.is_file() else None


def metrics(scores: dict[str, Any]) -> dict[str, float | None]:
    """Return the metrics of depth, classes and motion under the names of :func:`pipeline.report.dvc_files.metrics`."""
    values: dict[str, float | None] = {}
    for split in SPLITS:
        prefix = "" if split == "test" else f"{split}_"
        if classes := scores[split]["classes"]:
            values[f"encoder.{prefix}miou"] = classes["mean_iou"]
        for truth in ("dense", "lidar"):
            if depth := scores[split][f"depth_{truth}"]:
                values[f"encoder.{prefix}abs_rel_{truth}"] = depth["abs_rel"]
        for kind, splits in scores["motion"].items():
            if motion := splits[split]:
                names = ("nmse", "yaw_rmse_degps", "speed_ratio", "valid")
                values |= {f"motion.{kind}.{prefix}{name}": motion[name] for name in names}
    return values


def tables(scores: dict[str, Any]) -> list[Table]:
    """Return the tables of depth, classes and motion that have rows."""
    classes = [
        {"split": split, **row, "classes": len(row["iou"])} for split in SPLITS if (row := scores[split]["classes"])
    ]
    class_columns = {
        "split": ("split", ""), "frames": ("frames", ""), "pixel accuracy": ("pixel_accuracy", ".3f"),
        "mean IoU": ("mean_iou", ".3f"), "classes": ("classes", ""),
    }  # fmt: skip
    motion = [
        {"kind": kind, "split": split, **row}
        for (kind, splits), split in product(scores["motion"].items(), SPLITS)
        if (row := splits[split])
    ]
    motion_columns = {
        "motion": ("kind", ""), "split": ("split", ""), "drives": ("drives", ""), "frames": ("frames", ""),
        "measured": ("valid", ".1%"), "compared": ("judged", ""), "yaw rate RMSE deg/s": ("yaw_rmse_degps", ".3f"),
        "median": ("yaw_median_degps", ".3f"), "speed ratio": ("speed_ratio", ".3f"), "steering nmse": ("nmse", ".4f"),
    }  # fmt: skip
    return [
        *([Table("Depth", depth, _DEPTH)] if len(depth := _depth(scores)) else []),
        *_table("Classes", classes, class_columns, "Over the classes that occur in the ground truth."),
        *_table("Motion", motion, motion_columns, _MOTION),
    ]


def _table(title: str, rows: list[dict[str, Any]], columns: dict[str, tuple[str, str]], note: str) -> list[Table]:
    return [Table(title, cells(pd.DataFrame(rows, dtype=object), columns), note)] if rows else []


def _depth(scores: dict[str, Any]) -> pd.DataFrame:
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
    return pd.DataFrame(rows)
