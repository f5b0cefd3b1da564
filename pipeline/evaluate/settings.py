"""Section ``evaluate``: how the intervals of a model's errors are computed."""

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from pipeline.base.params import Positive, Section, Seed

# Baselines that use neither a network nor the truth → what they predict.
NO_LEARNING = {
    "zero": "always zero, which is straight ahead",
    "train_mean": "always the mean of the training drives",
    "odometry": "what the images show of the car's present motion, by visual odometry",
    "regression": "odometry times a factor that was fitted on the training drives",
}
# Those that are known only from the first measurement of a drive on.
MEASURED = ("odometry", "regression")
# Names of all baselines. persistence repeats true values, which no model gets.
BASELINES = (*NO_LEARNING, "persistence")
# Split → file of a model with the predictions of its drives.
PREDICTIONS = {"val": "validation.csv", "test": "predictions.csv"}


class Evaluate(Section):
    bootstrap_samples: int = Field(ge=1, le=100_000, description="draws of the bootstrap")
    bootstrap_block_s: Positive = Field(
        description="length of a block in seconds. A drive of two or more blocks is cut into parts "
        "of at least this length, which count as drives"
    )
    seed: Seed = Field(description="seed of the draws")


def find_difference(first: Mapping[str, Any], second: Mapping[str, Any]) -> str | None:
    """Return the first key whose values differ in two sections of settings, or None."""
    for key in sorted({*first, *second}):
        if first.get(key) != second.get(key):
            return key
    return None
