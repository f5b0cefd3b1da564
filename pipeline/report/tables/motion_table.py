"""What measured motion is worth, as a Markdown table."""

from collections.abc import Mapping
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.tables.markdown import table

Cards = Mapping[str, Any]  # kind → split → figures, see pipeline.perception.motion_scores.card
READING = (
    "Motion since the frame before, measured without oxts and judged by it, not below the labels' `min_speed_mps`. "
    "*nmse* is that of the steering angle which the last measurement says, over the *judged* frames, in each drive "
    "from the first measured one on: what two frames show without any learning. Not every drive has scans, so kinds "
    "may be judged on different drives."
)


def markdown(motion: Cards) -> str:
    """Return the table of the score cards of stage scores; empty where nothing was measured."""
    rows = [
        [kind, split, str(card["drives"]), str(card["frames"]), f"{card['valid']:.1%}", str(card["judged"])]
        + [_number(card[key]) for key in ("yaw_rmse_degps", "yaw_median_degps", "speed_ratio", "nmse")]
        for kind, splits in motion.items()
        for split in SPLITS
        if (card := splits[split])
    ]
    if not rows:
        return ""
    head = ["motion", "split", "drives", "frames", "measured", "judged", "yaw rate RMSE deg/s", "median", "speed ratio"]
    head.append("steering nmse")
    return "\n".join([*table(head, rows), "", READING, ""])


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f}" if abs(value) < 0.1 else f"{value:.3f}"
