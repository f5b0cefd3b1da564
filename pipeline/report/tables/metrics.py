"""The figures of all models under flat, short names: the columns of ``dvc metrics show`` and ``dvc exp show``."""

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.tables import comparison

Figures = dict[str, float]
TRUTHS = ("dense", "lidar")  # of depth
ODOMETRY = ("odometry", "odometry_lidar")
MOTION = ("nmse", "yaw_rmse_degps", "speed_ratio", "valid")


def figures(results: Sequence[comparison.Result], scores: Mapping[str, Any] | None) -> Figures:
    """Return name → value.

    ``<model>.nmse``, its 95 % interval ``nmse_low`` to ``nmse_high``, ``mae_deg``; ``odometry-<horizon>.nmse`` of the
    measured angle on the test drives, of scans beside images ``odometry_lidar-…``; ``encoder.miou`` of classes,
    ``encoder.abs_rel_dense`` and ``encoder.abs_rel_lidar`` of depth by either truth; ``motion.<kind>.nmse`` of steering
    by measured motion, ``yaw_rmse_degps``, ``speed_ratio``, ``valid``. Those of the other splits begin with ``train_``
    or ``val_``. What was not measured is left out: DVC shows a gap.

    Args:
        results: the ``metrics.json`` of models that are evaluated, :func:`comparison.in_order`.
        scores: the ``metrics.json`` of stage scores, split → scores, and ``motion``; None where it is not.
    """
    values: dict[str, float | None] = {}
    for result in results:
        model, test = result["model"], result["test"]
        low, high = test["nmse_ci95"]
        values |= {f"{model}.nmse_low": low, f"{model}.nmse_high": high, f"{model}.mae_deg": test["mae_deg"]}
        values |= {f"{model}.{_prefix(split)}nmse": result[split]["nmse"] for split in SPLITS if result[split]}
    for group in comparison.by_horizon(results):
        horizon, known = comparison.horizon(group[0]), comparison.baselines(group)
        values |= {f"{name}-{horizon}.nmse": known[name]["test"]["nmse"] for name in ODOMETRY if name in known}
    for split in SPLITS if scores else ():
        assert scores
        of_split = scores[split]
        if classes := of_split["classes"]:
            values[f"encoder.{_prefix(split)}miou"] = classes["mean_iou"]
        for truth in TRUTHS:
            if depth := of_split[f"depth_{truth}"]:
                values[f"encoder.{_prefix(split)}abs_rel_{truth}"] = depth["abs_rel"]
    for kind, splits in (scores or {}).get("motion", {}).items():
        for split, card in splits.items():
            values |= {f"motion.{kind}.{_prefix(split)}{name}": card[name] for name in MOTION if card}
    return {name: value for name, value in values.items() if value is not None}


def _prefix(split: str) -> str:
    """The test split's figures are the ones that count: they go by the plain name."""
    return "" if split == "test" else f"{split}_"
