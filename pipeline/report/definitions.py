"""Define the words of a report."""

import re
from textwrap import fill

from pipeline.evaluate.settings import NO_LEARNING

# Words of tables and sentences → their meanings. Those of a text define only what it names.
DEFINITIONS = {
    "displacement": (
        "the distance between the predicted and the driven path after a length of path, both with "
        "the mean curvature of each range; the mean over frames, so that slow stretches count more "
        "per metre. It resembles the final displacement error (FDE) of other work, but compares at "
        "equal lengths instead of equal times."
    ),
    "nmse": (
        "MSE / MSE of always predicting zero: 0 is perfect, 1 is useless. Without a range, it is "
        "the mean over the ranges."
    ),
    "interval": (
        "in parentheses or below an error stands its 95 % interval, bootstrapped over roads and "
        "seeds. After ± stands the standard deviation between seeds."
    ),
    "MAE": "mean absolute error, with its unit.",
    "drift": (
        "how far the path that follows from the predicted angles ends from that of the labelled "
        "angles, m per 100 m of way (Figure 5 of the paper). Both have the measured speed."
    ),
    "edges": "directed kNN edges per frame after pruning, of networks that get them.",
    "paper: test MSE": (
        "MSE in the paper's Table 2. It is too large for rad² of this label (docs/paper.md), so "
        "only ratios can be compared."
    ),
    **{name: f"a baseline: {meaning}." for name, meaning in NO_LEARNING.items()},
    "persistence": "a baseline: the last true value, which no model gets.",
    "differences": (
        "paired differences of errors, mean over the seeds, with their 95 % intervals: below 0, "
        "the first is better. A verdict is read from the printed bounds, of one error only. One "
        "seed is too few to compare methods: add some to train.seeds. Fewer than ten drives are "
        "too few, too."
    ),
    "the paper's claims": (
        "nmse and mean absolute error of both networks; MSE of the first relative to the second's, "
        "in the paper's Table 2 and here; the verdict is by the paired difference in nmse."
    ),
    "error / depth": (
        "mean over frames of the mean of |d − d*| / d*, of depths from 1 to 80 m in KITTI's Eigen "
        "crop. Only pixels with a predicted depth d and a true depth d* count."
    ),
    "within 25 %": "share of the pixels whose d / d* is between 1 / 1.25 and 1.25.",
    "coverage": "share of the pixels with a true depth that have a predicted one.",
    "level road": (
        "depth by a level road on the same pixels, which an encoder that has learned depth beats."
    ),
    "mean IoU": "intersection over union, mean over the classes in the truth.",
    "frames measured": (
        "share of the frames whose motion is measured in the images. A frame that is not measured "
        "has the angle of the frame before."
    ),
}


def define_words(text: str) -> dict[str, str]:
    """Return those of DEFINITIONS whose words are in a text."""
    return {
        word: meaning
        for word, meaning in DEFINITIONS.items()
        if re.search(rf"\b{re.escape(word)}(?!\w)", text, re.IGNORECASE)
    }


def write_definitions(text: str) -> str:
    """Return the definitions of the words of a text in Markdown."""
    lines = "## Definitions\n\n"
    for word, meaning in define_words(text).items():
        lines += fill(f"- {word}: {meaning}", 110, subsequent_indent="  ") + "\n"
    return lines
