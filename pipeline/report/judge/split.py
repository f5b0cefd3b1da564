"""The figures of one split, as they stand in metrics.json."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.report.judge.baselines import baselines, last_valid
from pipeline.report.judge.errors import by_curvature, scores
from pipeline.report.judge.interval import nmse_interval, nmse_std
from pipeline.sections.evaluate import Evaluate
from pipeline.train.windows import Drive


def figures(
    drives: Sequence[Drive],
    predicted_rad: Sequence[Sequence[np.ndarray]],
    settings: Evaluate,
    train_mean_rad: float,
) -> dict[str, Any]:
    """Return errors, interval, baselines and bins of predictions by seed and drive, [G] rad each.

    Frames that are invalid or too early for a whole window do not count.
    """
    judged = [drive.valid & ~np.isnan(angles) for drive, angles in zip(drives, predicted_rad[0], strict=True)]

    def column(of_drive: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([values[rows] for values, rows in zip(of_drive, judged, strict=True)])

    steering = column([drive.steering_rad for drive in drives])
    predicted = np.stack([column(of_seed) for of_seed in predicted_rad])  # [S,N]
    before = column([last_valid(drive.steering_rad, drive.valid) for drive in drives])
    number = column([np.full(len(drive.frame), index) for index, drive in enumerate(drives)])
    curvature = column([drive.curvature_1pm for drive in drives])
    interval = nmse_interval(
        steering, predicted, number, settings.bootstrap_block_frames, settings.bootstrap_samples, settings.seed
    )
    return scores(steering, predicted) | {
        "nmse_std": nmse_std(steering, predicted),
        "nmse_ci95": list(interval),
        "baselines": baselines(steering, before, train_mean_rad),
        "by_curvature": by_curvature(steering, predicted, curvature, settings.curvature_bins_1pm),
    }


def sizes(drives: Sequence[Drive]) -> dict[str, float | None]:
    """Return means over the drives' frames: points, kNN edges before and after pruning; None for what there is not."""
    counts: dict[str, list[np.ndarray]] = {"points": [], "edges_knn": [], "edges_kept": []}
    for drive in drives:
        with store.DriveReader(drive.graphs, stage="graphs") as file:
            if "ptr" in file:
                counts["points"].append(np.diff(file["ptr"]))
            for name in ("edges_knn", "edges_kept"):
                if name in file:
                    counts[name].append(file[name])
    points, knn, kept = (float(np.concatenate(parts).mean()) if parts else None for parts in counts.values())
    return {"points_per_frame": points, "edges_per_frame": kept, "edges_per_frame_unpruned": knn}
