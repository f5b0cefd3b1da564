"""How the learning rate goes over a training run."""

import math


def warm_up_cosine(progress: float, warm_up: float) -> float:
    """Return the share of the full rate at `progress` in [0,1]: up in a line until `warm_up`, down in half a cosine."""
    if progress < warm_up:
        return 0.05 + 0.95 * progress / warm_up
    return 0.5 * (1 + math.cos(math.pi * (progress - warm_up) / (1 - warm_up)))
