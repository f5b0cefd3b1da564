"""Train a network on cached graphs and labels in a loop of your own.

Run it in the repository's root, after make demo: python -m examples.train_loop
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer

from models.steering.core.steering_net import SteeringNet
from pipeline.base import store
from pipeline.train.entry import Entry
from pipeline.train.loss import Scale
from pipeline.train.targets import LabelledDrive, read_drive
from pipeline.train.windows import Reader, split_spans

# Frames of a window. The network predicts the steering of the last one.
WINDOW = 8
# Consecutive windows that share the features of their frames in a step.
WINDOWS_PER_SPAN = 4
# Spans of a step.
SPANS_PER_STEP = 8


def main(
    data: Annotated[Path, typer.Option(help="folder with graphs/ and labels/")] = Path("data"),
    epochs: int = 2,
) -> None:
    """Train a network, and print its error on the validation drives in degrees."""
    # The keys are those of an entry of section models in params.yaml.
    entry = Entry.model_validate(
        {"input": "semantic", "spatial": "gnn", "temporal": "lstm", "semantics": 1.0}
    )
    training = read_split(data, "train", entry)
    validation = read_split(data, "val", entry)

    torch.manual_seed(0)
    network = entry.build(kind="graph")
    optimiser = torch.optim.Adam(network.parameters(), lr=0.01)

    # Outputs are in units of the standard deviation of the training angles.
    scale = Scale.from_drives(training)
    std = torch.from_numpy(scale.std).float()

    reader = Reader(training, WINDOW)
    rng = np.random.default_rng(0)
    for epoch in range(epochs):
        all_spans = split_spans(training, WINDOW, WINDOWS_PER_SPAN, rng)
        rng.shuffle(all_spans)
        losses = []
        for start in range(0, len(all_spans), SPANS_PER_STEP):
            # A batch is a dict of tensors, see pipeline/train/windows.py. A frame that has no label
            # has the target NaN.
            batch = reader[all_spans[start : start + SPANS_PER_STEP]]
            target = batch["target"] / std  # [W,1]
            output = network(*network.inputs(batch))  # [W,1]
            loss = (output - target)[target.isfinite()].square().mean()

            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            losses.append(loss.item())
        error_deg = validate(network, validation, scale)
        print(f"epoch {epoch}: loss {np.mean(losses):.3f}, validation {error_deg:.2f}° (MAE)")


def read_split(data: Path, split: str, entry: Entry) -> list[LabelledDrive]:
    """Read the drives of a split. Their graphs stay on disk."""
    labels = data / "labels"
    drives = store.drives_in(store.read_index(labels, stage="labels"), split)
    graphs = data / "graphs" / entry.input
    return [read_drive(graphs, labels, data / "motion", drive, entry) for drive in drives]


@torch.no_grad()
def validate(network: SteeringNet, drives: list[LabelledDrive], scale: Scale) -> float:
    """Return the mean absolute error of the angle in degrees, over all labelled windows."""
    network.eval()
    reader = Reader(drives, WINDOW)
    errors_rad = []
    for span in split_spans(drives, WINDOW, windows=32):
        batch = reader[[span]]
        output = network(*network.inputs(batch))

        # Outputs become angles in rad. `base` is 0, because this network gets no measured motion.
        predicted_rad = scale.decode(output.numpy(), batch["base"].numpy())
        errors_rad.append(predicted_rad - batch["target"].numpy())
    network.train()
    return float(np.degrees(np.nanmean(np.abs(np.concatenate(errors_rad)))))


if __name__ == "__main__":
    typer.run(main)
