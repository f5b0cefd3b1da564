"""What an image costs with each backbone of the unified encoder, and what one pass for two outputs saves."""

import contextlib
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from torch import Tensor, nn

from benchmarks import town_frames
from models.encoder.unified_encoder import BACKBONES, UnifiedEncoder
from pipeline.base import console, store
from pipeline.base.errors import InputError, closest
from pipeline.base.params import load
from pipeline.camera.images import read_image
from pipeline.camera.pixels import read_pixels
from pipeline.encoder.perceive import passes, perceive
from pipeline.sections.perception import Perception

DEFAULT = ["small", "espnetv2-s1", "espnetv2", "dinov2-vits14", "swin-t"]
HEADS = ("depth_head", "class_head")
FRAMES = 8  # rendered; enough to read from


@dataclass(frozen=True)
class Row:
    """One backbone's figures; times are medians, in seconds for one image."""

    backbone: str
    parameters: int
    network_s: float  # from uint8 pixels to depth and classes in memory, as stage perception runs it: side by side
    both_s: float  # the network's forward pass alone, each on all cores
    single_s: tuple[float, float]  # the same with one head, depth or classes


@dataclass(frozen=True)
class Reading:
    """What it takes to have an image; medians, in seconds for one."""

    stored_s: float  # stage perception: out of a file of stage ingest
    raw_s: float  # stage ingest, once: decode a PNG of the camera's size and resize it


def main(
    backbones: Annotated[list[str] | None, typer.Argument(metavar="BACKBONE", help="others: dinov2-vitb14, …")] = None,
    preset: Annotated[
        str, typer.Option(help="whose image size, batch and precision: a name in presets/, or a file")
    ] = "kitti",
    rounds: Annotated[int, typer.Option(min=1, help="timed, after one that is not")] = 5,
) -> None:
    """Time each backbone with random weights on rendered images, and print a Markdown table."""
    for name in backbones or []:
        if name not in BACKBONES:
            raise InputError(f"there is no backbone {name!r}: {closest(name, list(BACKBONES))}")
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stdout(sys.stderr):
        folder = Path(scratch)
        town_frames.write_params(preset, folder / "params.yaml", FRAMES)
        town_frames.record(folder / "params.yaml", folder)
        reading, images, K = read(folder, rounds)
        batch = images[: load(Perception, folder / "params.yaml").batch]
        rows = [measure(name, batch, K, rounds) for name in backbones or DEFAULT]
    device = "cuda" if torch.cuda.is_available() else f"cpu, {torch.get_num_threads()} threads"
    print(table(rows, reading))
    print(f"\n{device}; {batch.shape[1]} × {batch.shape[2]} pixels, {len(batch)} images a pass")


def read(folder: Path, rounds: int) -> tuple[Reading, np.ndarray, np.ndarray]:
    """Time how the frames that town_frames recorded in `folder` are read; return them [F,H,W,3] and their K too."""
    stored, raw = [], []
    pngs = sorted(folder.glob(f"town/*/{town_frames.DRIVE}_sync/image_02/data/*.png"))
    height, width = read_pixels(pngs[0]).shape[:2]
    for _ in range(rounds):
        with store.DriveReader(folder / f"ingest/{town_frames.DRIVE}.h5", stage="ingest") as file:
            start = time.perf_counter()
            images = file["image"]
            stored.append((time.perf_counter() - start) / len(images))
            K = file["K"]
        start = time.perf_counter()
        for png in pngs:
            read_image(png, (height, width), images.shape[1:3])
        raw.append((time.perf_counter() - start) / len(pngs))
    return Reading(statistics.median(stored), statistics.median(raw)), images, K


def measure(backbone: str, images: np.ndarray, K: np.ndarray, rounds: int) -> Row:
    """Time a backbone with random weights on a batch of images uint8 [B,H,W,3] with intrinsics [3,3]."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(0)
    model = UnifiedEncoder(backbone).eval().to(device)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # as stage perception does
    depth, classes = (without(model, backbone, head) for head in reversed(HEADS))
    pixels = torch.from_numpy(images).to(device).permute(0, 3, 1, 2)
    intrinsics = torch.from_numpy(K).to(device).expand(len(images), 3, 3)

    def forward(net: nn.Module) -> None:
        net(pixels, intrinsics)[0].cpu()  # waits for the device

    side = 1 if torch.cuda.is_available() else torch.get_num_threads()

    def as_in_the_stage() -> None:
        list(passes(lambda batch: perceive(model, batch, K, "auto"), (images for _ in range(side))))

    runs: list[Callable[[], Any]] = [as_in_the_stage, *(partial(forward, net) for net in (model, depth, classes))]
    with torch.inference_mode():
        # In turns: what else the machine does meets all of them.
        times = np.array([[_seconds(run) for run in runs] for _ in range(rounds + 1)][1:]) / len(images)
        times[:, 0] /= side
    network_s, both_s, depth_s, classes_s = np.median(times, axis=0).tolist()
    parameters = sum(parameter.numel() for parameter in model.parameters())
    return Row(backbone, parameters, network_s, both_s, (depth_s, classes_s))


class Nothing(nn.Module):
    """A head that is not there."""

    def forward(self, features: Any, rays: Tensor) -> Tensor:
        return rays[:, 0]


def without(model: UnifiedEncoder, backbone: str, head: str) -> UnifiedEncoder:
    """Return a model with the same weights and one head only."""
    single = UnifiedEncoder(backbone)
    for part in ("backbone", *HEADS):
        setattr(single, part, Nothing() if part == head else getattr(model, part))
    return single.eval()


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def table(rows: list[Row], reading: Reading) -> str:
    """Return the rows as Markdown."""
    head = ["backbone", "parameters", "images/s", "ms an image", "reading", "two models, ms", "one pass is faster"]
    lines = [head, ["---", *["--:"] * (len(head) - 1)]]
    for row in rows:
        share = reading.stored_s / (reading.stored_s + row.network_s)
        depth_s, classes_s = row.single_s
        lines.append([
            *(row.backbone, f"{row.parameters:,}", f"{1 / row.network_s:.1f}", f"{1e3 * row.network_s:.1f}"),
            *(f"{share:.0%}", f"{1e3 * depth_s:.1f} + {1e3 * classes_s:.1f}"),
            f"{(depth_s + classes_s) / row.both_s:.2f} ×",
        ])  # fmt: skip
    return "\n".join([
        *(f"| {' | '.join(cells)} |" for cells in lines),
        f"\nreading a stored image: {1e3 * reading.stored_s:.1f} ms; "
        f"decoding and resizing a PNG of the camera's size, as stage ingest does once: {1e3 * reading.raw_s:.1f} ms",
    ])  # fmt: skip


if __name__ == "__main__":
    console.run(main)
