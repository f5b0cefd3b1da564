"""Predict depth and classes of images with the encoder of a folder: a network, or precomputed
files.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from pipeline.base.checkout import in_checkout
from pipeline.base.errors import error_context
from pipeline.base.executors import default_workers
from pipeline.base.loop import prefetch
from pipeline.base.resume import file_hash
from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera import classes
from pipeline.camera.camera import Camera, read_camera
from pipeline.camera.images import DEPTH_UNITS_PER_M, to_units
from pipeline.encoder import precomputed
from pipeline.encoder.encoder_file import FILE, load
from pipeline.perception.reach import limit_traffic_depth
from pipeline.perception.settings import Perception

GPU_BATCH = 32  # images per pass at least; a CPU runs them one by one


class EncoderInput(NamedTuple):
    """B frames of a drive."""

    drive: str
    frame: Sequence[int] | np.ndarray  # KITTI frame numbers [B]
    images: np.ndarray  # RGB uint8 [B,H,W,3]
    camera: Camera


Perceived = tuple[np.ndarray, np.ndarray]  # depth float32 [B,H,W] in metres, trainIds uint8 [B,H,W]
Predict = Callable[[EncoderInput], Perceived]


class OpenEncoder(NamedTuple):
    """The encoder of a folder."""

    predict: Predict
    datasets: list[str] | None  # of its fit; None: unknown
    # Factor beyond which depth must be in other units, infinite for random weights. A network of
    # images of one camera takes a lorry's camera, twice as high, for that one. A wrong unit of
    # files is wrong by 2 or more.
    unit_error: float


def open_encoder(folder: Path, precision: str) -> OpenEncoder:
    """Open an encoder's folder; `precision` as in section perception. Raises InputError if it
    cannot be read.
    """
    return _open(folder, file_hash(folder / FILE), precision)


def warnings(folder: Path, precision: str, ingest: Iterable[Path]) -> Iterator[str]:
    """Yield a warning if an encoder was fitted to the sample alone, and a drive's ingest file is of
    another.
    """
    for path in ingest if open_encoder(folder, precision).datasets == ["sample"] else ():
        with DriveReader(path, stage="ingest") as file:
            if file.params.get("dataset", "sample") != "sample":
                fix = (
                    "Use the encoder of make street, weights/street, and ingest.image_size: [192, "
                    "640]"
                )
                yield (
                    f"{folder} was fitted to rendered streets alone: wrong depth on {file.drive}. "
                    f"{fix}"
                )
                return


@lru_cache(maxsize=1)  # one for all drives of a process; a worker of a cluster outlives the file
def _open(folder: Path, _: str, precision: str) -> OpenEncoder:
    with error_context(fix="Make it again: dvc repro --force --single-item encoder"):
        architecture, network = load(folder / FILE)
    datasets = architecture.get("datasets")
    if architecture["backbone"] == "precomputed":
        files = in_checkout(Path(architecture["folder"]))
        return OpenEncoder(partial(_read_precomputed, files), datasets, 1.8)
    random = not datasets and architecture["backbone"] in ("small", "hugging_face")
    predict: Predict = lambda batch: perceive(network, batch.images, batch.camera, precision)  # noqa: E731
    return OpenEncoder(predict, datasets, np.inf if random else 3.5)


def _read_precomputed(folder: Path, batch: EncoderInput) -> Perceived:
    frames = [
        precomputed.read(folder, batch.drive, int(frame), batch.camera.size)
        for frame in batch.frame
    ]
    return np.stack([depth for depth, _ in frames]), np.stack([cls for _, cls in frames])


def perceive(
    model: nn.Module, images: np.ndarray, camera: Camera, precision: str = "float32"
) -> Perceived:
    """Return depth float32 [B,H,W] in metres and trainIds uint8 [B,H,W] of RGB images uint8
    [B,H,W,3].

    With `precision` auto products are in bfloat16 on a GPU that has it, otherwise in the weights'
    precision. On a CPU, images run one by one: an image's last bits depend on the batch size, and
    steer predict has one at a time.
    """
    device = next(model.parameters()).device
    tensors, at_once = [torch.from_numpy(images), torch.from_numpy(camera.K)], 1
    if device.type != "cpu":
        tensors, at_once = [tensor.pin_memory() for tensor in tensors], len(images)
    torch.backends.cudnn.allow_tf32 = precision == "auto"
    native = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    half = torch.autocast(device.type, torch.bfloat16, enabled=precision == "auto" and native)
    with torch.no_grad(), half:  # BEiT keeps tensors, which a fit uses again
        pixels, intrinsics = (tensor.to(device, non_blocking=True) for tensor in tensors)
        parts = torch.split(pixels.permute(0, 3, 1, 2), at_once)
        outputs = [model(part, intrinsics.expand(len(part), 3, 3)) for part in parts]
        depth = torch.cat([depth.float() for depth, _ in outputs])
        cls = torch.cat([logits.argmax(dim=1) for _, logits in outputs])
        # some networks have logits of void, last
        cls.masked_fill_(cls == classes.COUNT, classes.VOID)
        return depth.cpu().numpy(), cls.to(torch.uint8).cpu().numpy()


def passes(predict: Predict, batches: Generator[EncoderInput]) -> Generator[Perceived]:
    """Yield ``predict(batch)`` of each batch, in order, with equal bytes for any number of cores.
    Closes `batches`.

    Splitting a sum among threads changes its last bits. So each forward pass on a CPU uses one
    thread, and several passes run side by side; a GPU runs one pass at a time.
    """
    threads = torch.get_num_threads()
    use_one_thread = partial(torch.set_num_threads, 1)
    # STEER_WORKERS limits memory
    workers = 1 if torch.cuda.is_available() else min(threads, default_workers())
    use_one_thread()
    try:
        with (
            closing(batches),
            closing(prefetch(predict, batches, workers, workers + 1, use_one_thread)) as results,
        ):
            yield from results
    finally:
        torch.set_num_threads(threads)


def perceive_drive(
    path: Path,
    ingest: Path,
    encoder: Path,
    settings: Perception,
    *,
    advance: Callable[[int], object] = lambda frames: None,
) -> Summary:
    """Write depth and classes of each image of a drive, ``data/perception/<drive>.h5``, by an
    encoder's folder.

    `advance` is called with the number of frames that are done since the last call.
    """
    opened = open_encoder(encoder, settings.precision)
    sections = {
        "encoder": {"sha256": file_hash(encoder / FILE)},
        "perception": settings.model_dump(),
    }
    with (
        DriveReader(ingest, stage="ingest") as source,
        DriveWriter(
            path, stage="perception", drive=source.drive, params=source.params | sections
        ) as file,
    ):
        camera, with_image = read_camera(source), np.flatnonzero(source["has_image"])
        file.attrs["unit_error"] = opened.unit_error if camera.height_known else np.inf
        file.put("frame", source.frame[with_image])
        file.put("time_s", source.time_s[with_image], "s")
        file.append(
            "depth_m", np.zeros((0, *camera.size), np.uint16), f"1/{DEPTH_UNITS_PER_M} m, 0 = none"
        )
        file.append("cls", np.zeros((0, *camera.size), np.uint8), "Cityscapes trainId")
        size = max(settings.batch, GPU_BATCH) if torch.cuda.is_available() else settings.batch
        batches = read_batches(source, camera, with_image, size)
        # One thread reads, others run the network, this one caps the depth of traffic and writes.
        with closing(passes(opened.predict, batches)) as results:
            for depth, cls in results:
                if settings.reach:
                    for depth_m, trainids in zip(depth, cls, strict=True):
                        limit_traffic_depth(depth_m, trainids, camera, settings.reach)
                file.append("depth_m", to_units(np.where(cls == classes.SKY, 0, depth)))
                file.append("cls", cls)
                advance(len(cls))
    return {"frames": len(with_image)}


def read_batches(
    source: DriveReader, camera: Camera, rows: np.ndarray, size: int
) -> Generator[EncoderInput]:
    """Yield the frames in `rows` of a file of stage ingest in batches of `size`."""
    for start in range(0, len(rows), size):
        batch = rows[start : start + size]
        # Row by row, since frames without an image in between must not be read.
        images = np.stack([source.row("image", row) for row in batch])
        yield EncoderInput(source.drive, source.frame[batch], images, camera)
