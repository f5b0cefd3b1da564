"""Learning rate over the steps of a fit."""

import math


def warm_up_cosine(progress: float, warm_up: float) -> float:
    """Return the factor of the learning rate at `progress` in [0,1]: linear up to `warm_up`, then half a cosine."""
    if progress < warm_up:
        return 0.05 + 0.95 * progress / warm_up
    return 0.5 * (1 + math.cos(math.pi * (progress - warm_up) / (1 - warm_up)))
