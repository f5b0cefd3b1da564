"""Section ``evaluate``: how the intervals of a model's errors are computed."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, Section, Seed

# Baselines that use neither a network nor the truth → what they predict.
NO_LEARNING = {
    "zero": "always zero, which is straight ahead",
    "train_mean": "always the mean of the training drives",
    "odometry": "what the images show of the car's present motion, by visual odometry",
    "regression": "odometry times a factor that was fitted on the training drives",
}
# Names of all baselines. persistence repeats true values, which no model gets.
BASELINES = (*NO_LEARNING, "persistence")


class Evaluate(Section):
    # Number of draws of the bootstrap.
    bootstrap_samples: Annotated[int, Field(ge=1, le=100_000)]
    # A long drive is cut into parts, which have at least this number of frames each.
    bootstrap_block_frames: Count
    # Seed of the draws.
    seed: Seed
