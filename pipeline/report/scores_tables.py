"""Write the errors of depth, classes and motion as tables."""

from collections.abc import Mapping
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.number_text import value_text
from pipeline.report.section import Section, to_table

# Part of the scores → title of its table.
SCORES = {
    "depth_dense": "Depth, compared with dense truth",
    "depth_lidar": "Depth, compared with LiDAR",
    "ground_plane_dense": "Depth of a level road, compared with dense truth",
    "ground_plane_lidar": "Depth of a level road, compared with LiDAR",
    "classes": "Classes, compared with dense truth",
    "motion": "Motion by visual odometry, compared with recorded motion",
}
# Score → its column.
SCORE_HEADS = {
    "abs_rel": "error / depth",
    "rmse_m": "RMSE, m",
    "delta1": "within 25 %",
    "mean_iou": "mean IoU",
    "pixel_accuracy": "pixel accuracy",
    "valid": "frames measured",
    "judged": "frames with an angle",
    "yaw_rmse_degps": "yaw rate: RMSE, deg/s",
    "yaw_median_degps": "yaw rate: median error, deg/s",
    "speed_ratio": "speed: measured / recorded",
    "nmse": "nmse of the angle",
}


def scores_tables(scores: Mapping[str, Any]) -> list[Section]:
    """Return a table of each part of scores/metrics.json that has values, with a row per split."""
    if not scores:
        return []
    parts = {split: scores[split] | {"motion": scores["motion"][split]} for split in SPLITS}
    sections = []
    for part in parts["test"]:
        rows = {split: _score_cells(parts[split][part]) for split in SPLITS if parts[split][part]}
        if rows:
            sections.append(Section(SCORES[part], to_table(rows, "split")))
    return sections


def _score_cells(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the cells of the numbers of a part."""
    cells = {}
    for key, value in values.items():
        if not isinstance(value, dict):
            head = SCORE_HEADS.get(key, key)
            cells[head] = value_text(value, "" if isinstance(value, int) else ".3g")
    return cells
