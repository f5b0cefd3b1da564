"""Renew the hashes of code in the included networks, if their predictions have not changed.

Run it in the repository's root after an edit of models/steering: python -m pipeline.check.renew
"""

import torch
from torch import Tensor

from models.steering.core.batch import from_arrays
from models.steering.core.recurrent import NOMINAL_STEP_S
from pipeline.base import checkpoint, console
from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT
from pipeline.check.street_frames import join_frames, make_frames
from pipeline.graphs.settings import Variant
from pipeline.train.trained import KIND, Trained, code_hashes, load_model

# Folders of the included networks.
FOLDERS = ("models/steering/sample", "models/steering/sample_path")
# Number of points of each frame of the window on which predictions are compared.
POINTS = 300
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
    """Return the standardised outputs [1,R] of a network for a window of streets in memory."""
    variant = Variant.model_validate(model.settings["graphs"])
    window = model.entry.window
    frames = make_frames(variant, [POINTS] * window, (96, 320), seed=0)
    motion = None
    if model.net.motion:
        motion = torch.tensor([0.1, 0.3, 8.0, 1.0]).repeat(window, 1)
    with torch.inference_mode():
        windows = torch.arange(window)[None]
        dt_s = torch.full((1, window), NOMINAL_STEP_S)
        return model.net(from_arrays(join_frames(frames)), windows, dt_s, motion)


if __name__ == "__main__":
    console.run(main)
