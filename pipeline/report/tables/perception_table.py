"""What depth and classes are worth that stage perception wrote, as Markdown tables."""

from collections.abc import Mapping
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.tables.markdown import table

Scores = Mapping[str, Any]  # of a split, see pipeline.perception.scores.Scores.report
TRUTHS = {"lidar": "LiDAR", "dense": "dense"}
READING = (
    "Each depth as abs rel, RMSE in metres, δ1, at 1 to 80 m: means over frames. *Coverage* is the share of those "
    "pixels that have a depth, which the encoder's sky has not; only they are scored. *Flat ground* is a level road "
    "under the camera, with the encoder's classes, at the same pixels: an encoder that is no better knows no depth. "
    "*Eigen* is KITTI's crop of that name (pipeline/perception/scores.py)."
)


def markdown(metrics: Mapping[str, Scores]) -> str:
    """Return the tables of the ``metrics.json`` of stage scores, split → scores; empty where nothing was scored."""
    depths = [
        [split, name, str(whole["frames"]), f"{whole['coverage']:.1%}"]
        + [_errors(metrics[split][key]) for key in _keys(truth)]
        for split in SPLITS
        for truth, name in TRUTHS.items()
        if (whole := metrics[split][f"depth_{truth}"])
    ]
    classes = [
        [
            split,
            str(scores["frames"]),
            f"{scores['pixel_accuracy']:.3f}",
            f"{scores['mean_iou']:.3f}",
            str(len(scores["iou"])),
        ]
        for split in SPLITS
        if (scores := metrics[split]["classes"])
    ]
    lines: list[str] = []
    if depths:
        head = ["depth of", "truth", "frames", "coverage"]
        head += [f"{what}{crop}" for crop in ("", ", Eigen") for what in ("encoder", "flat ground")]
        lines += [*table(head, depths), "", READING, ""]
    if classes:
        lines += [*table(["classes of", "frames", "pixel accuracy", "mean IoU", "of so many classes"], classes), ""]
    return "\n".join(lines)


def _keys(truth: str) -> list[str]:
    return [f"{what}_{truth}{crop}" for crop in ("", "_eigen") for what in ("depth", "ground_plane")]


def _errors(scores: Mapping[str, float] | None) -> str:
    return "{abs_rel:.3f}, {rmse_m:.2f}, {delta1:.3f}".format_map(scores) if scores else "none"
