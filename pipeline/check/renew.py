"""Renew the hashes of code in the included networks, if their predictions have not changed.

Run it in the repository's root after an edit of models/steering: python -m pipeline.check.renew
"""

import numpy as np
import torch
from torch import Tensor

from models.steering.core.batch import from_arrays
from models.steering.core.recurrent import NOMINAL_STEP_S
from pipeline.base import checkpoint, console
from pipeline.base.errors import InputError
from pipeline.base.keys import ROOT
from pipeline.check.street_frames import join_frames, make_frames
from pipeline.graphs.settings import Variant
from pipeline.train.trained import KIND, Trained, code_hashes, load_model

# Folders of the included networks.
FOLDERS = ("models/steering/sample", "models/steering/sample_path")
# Numbers of points of the frames on which predictions are compared, in turn.
POINTS = (300, 150, 0, 300)
# Number of windows on which predictions are compared.
WINDOWS = 4
# Largest difference of an output, in standard deviations of the predicted quantity. Processors
# differ by 1e-6.
TOLERANCE = 1e-4


def main() -> None:
    """Write new hashes. Raises InputError, and writes nothing, if an output has changed."""
    contents = {}
    for folder in FOLDERS:
        path = ROOT / folder / "best.pt"
        model = load_model(path.parent, device="cpu")
        outputs = run_on_streets(model)
        content = checkpoint.read(path, KIND)
        expected = content.get("outputs", outputs)
        difference = (outputs - expected).abs().max().item()
        if difference > TOLERANCE:
            problem = f"its outputs changed by {difference:.2g} standard deviations"
            raise InputError(problem, path, "Undo the edit, or train the network again")
        contents[path] = content | {"code": code_hashes(model.entry), "outputs": expected}
    for path, content in contents.items():
        checkpoint.write(path, content)


def run_on_streets(model: Trained) -> Tensor:
    """Return the standardised outputs [W,R] of a network for windows of streets in memory.

    Their time steps and motion vary, and some frames have no points or no measured motion.
    """
    rng = np.random.default_rng(0)
    variant = Variant.model_validate(model.settings["graphs"])
    count = model.entry.window + WINDOWS - 1
    counts = [POINTS[row % len(POINTS)] for row in range(count)]
    frames = make_frames(variant, counts, (96, 320), seed=0)
    windows = np.arange(WINDOWS)[:, None] + np.arange(model.entry.window)
    dt_s = NOMINAL_STEP_S * rng.uniform(0.5, 2, windows.shape)

    motion = None
    if model.net.motion:
        measured = rng.integers(0, 2, count)
        columns = [rng.normal(0, 0.2, count), rng.normal(0, 0.3, count), rng.uniform(1, 15, count)]
        rows = np.stack([*columns, np.ones(count)], axis=1) * measured[:, None]
        motion = torch.from_numpy(rows).float()
    batch = from_arrays(join_frames(frames, model.entry.network))
    with torch.inference_mode():
        return model.net(batch, torch.from_numpy(windows), torch.from_numpy(dt_s).float(), motion)


if __name__ == "__main__":
    console.run(main)
