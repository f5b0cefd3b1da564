"""Predict depth and classes of images with an encoder.

The encoder is a network, or a folder of precomputed files.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from pipeline.base.checkout import in_checkout
from pipeline.base.errors import error_context
from pipeline.base.hashes import file_hash
from pipeline.base.loop import prefetch
from pipeline.base.store import DriveReader
from pipeline.base.summary import Summary
from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.images import to_units
from pipeline.encoder import precomputed
from pipeline.encoder.encoder_file import FILE, load_encoder
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.perception.perception_file import UNITS, create_perception
from pipeline.perception.settings import Perception

# Number of classes whose shares of the pixels are printed, the largest ones.
SHARES = 5
# Least number of images in a forward pass on a GPU. A CPU computes them one by one.
GPU_BATCH = 32
# Error of the scale of depth, as a factor, above which precomputed depth must be in another unit.
# Another unit is wrong by a factor of 2 or more.
FILES_UNIT_ERROR = 1.8
# Error of the scale of depth, as a factor, above which a network's depth must be in another unit.
# A network that was fitted to one camera is wrong by a factor of 2 for the camera of a lorry, which
# is twice as high.
NETWORK_UNIT_ERROR = 3.5


class EncoderInput(NamedTuple):
    """A batch of B frames of a drive."""

    drive: str
    frame: np.ndarray  # KITTI frame numbers [B]
    images: np.ndarray  # RGB uint8 [B,H,W,3]
    camera: Camera


class Perceived(NamedTuple):
    """Depth and classes of a batch of B images."""

    depth_m: np.ndarray  # float32 [B,H,W] in metres
    cls: np.ndarray  # trainIds uint8 [B,H,W]


Predict = Callable[[EncoderInput], Perceived]


class OpenEncoder(NamedTuple):
    """An encoder that is ready to predict."""

    predict: Predict
    datasets: list[str] | None  # datasets to which it was fitted; None if they are unknown
    # Error of the scale of depth, as a factor, above which depth must be in another unit. It is
    # infinite for random weights, whose depth has no scale.
    unit_error: float
    # Folder of precomputed files, if the encoder is one.
    files: Path | None = None


def open_encoder(folder: Path, precision: str) -> OpenEncoder:
    """Open the encoder in a folder. `precision` is the setting of section perception.

    Raises InputError if the encoder cannot be read.
    """
    return _open_file(folder, file_hash(folder / FILE), precision)


def find_warnings(folder: Path, precision: str, ingest: Iterable[Path]) -> Iterator[str]:
    """Yield a warning if an encoder that was fitted to the sample alone gets another dataset.

    `ingest` are the drives' files of stage ingest.
    """
    if open_encoder(folder, precision).datasets != ["sample"]:
        return
    for path in ingest:
        with open_ingest(path) as file:
            if file.params.get("dataset", "sample") != "sample":
                fix = "Use the encoder that steer street makes, "
                fix += "and ingest.image_size: [192, 640]"
                problem = f"{folder} was fitted to rendered streets alone"
                yield f"{problem}: wrong depth on {file.drive}. {fix}"
                return


# The encoder is kept for all drives of a process. Another file has another hash.
@lru_cache(maxsize=1)
def _open_file(folder: Path, sha256: str, precision: str) -> OpenEncoder:
    with error_context(fix="Make it again: dvc repro --force --single-item encoder"):
        architecture, network = load_encoder(folder / FILE)
    datasets = architecture.get("datasets")
    if architecture["backbone"] == "precomputed":
        files = in_checkout(Path(architecture["folder"]))
        read_files = partial(_read_precomputed, files)
        return OpenEncoder(read_files, datasets, FILES_UNIT_ERROR, files)

    def predict(batch: EncoderInput) -> Perceived:
        return perceive(network, batch.images, batch.camera, precision)

    unit_error = NETWORK_UNIT_ERROR
    # These networks have random weights if they were fitted to no dataset.
    if not datasets and architecture["backbone"] in ("small", "hugging_face"):
        unit_error = np.inf
    return OpenEncoder(predict, datasets, unit_error)


def _read_precomputed(folder: Path, batch: EncoderInput) -> Perceived:
    depths_m = []
    class_maps = []
    for frame in batch.frame.tolist():
        depth_m, cls = precomputed.read_frame(folder, batch.drive, frame, batch.camera)
        depths_m.append(depth_m)
        class_maps.append(cls)
    return Perceived(np.stack(depths_m), np.stack(class_maps))


def perceive(
    model: nn.Module, images: np.ndarray, camera: Camera, precision: str = "float32"
) -> Perceived:
    """Return depth and classes of RGB images uint8 [B,H,W,3].

    With `precision` auto, products are in bfloat16 on a GPU that supports it. Otherwise, they are
    in the precision of the weights. A CPU computes images one by one, since the last bits of a
    result depend on the batch size, and `steer predict` gets images one at a time.
    """
    device = next(model.parameters()).device
    pixels = torch.from_numpy(images)
    intrinsics = torch.from_numpy(camera.K)
    at_once = 1
    if device.type != "cpu":
        pixels = pixels.pin_memory()
        intrinsics = intrinsics.pin_memory()
        at_once = len(images)

    auto = precision == "auto"
    torch.backends.cudnn.allow_tf32 = auto
    native = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    half = torch.autocast(device.type, torch.bfloat16, enabled=auto and native)
    # BEiT keeps tensors that a later fit uses, so inference mode would not do.
    with torch.no_grad(), half:
        pixels = pixels.to(device, non_blocking=True)
        intrinsics = intrinsics.to(device, non_blocking=True)
        depths = []
        class_maps = []
        for batch in torch.split(pixels.permute(0, 3, 1, 2), at_once):
            depth, logits = model(batch, intrinsics.expand(len(batch), 3, 3))
            depths.append(depth.float())
            class_maps.append(logits.argmax(dim=1))
        cls = torch.cat(class_maps).to(torch.uint8)
        return Perceived(torch.cat(depths).cpu().numpy(), cls.cpu().numpy())


def run_passes(
    predict: Predict, batches: Generator[EncoderInput], max_passes: int | None = None
) -> Generator[Perceived]:
    """Yield ``predict(batch)`` for each batch, in order, and close `batches` at the end.

    Results are equal to the last bit for any number of cores. Splitting a sum among threads would
    change its last bits, so each forward pass on a CPU uses one thread, and several passes run at
    the same time: as many as torch has threads, and at most `max_passes`, which limits the memory
    that is used. A GPU runs one pass at a time.
    """
    threads = torch.get_num_threads()
    use_one_thread = partial(torch.set_num_threads, 1)
    workers = 1
    if not torch.cuda.is_available():
        workers = min(threads, max_passes or threads)
    use_one_thread()
    try:
        passes = prefetch(predict, batches, threads=workers, ahead=workers + 1, init=use_one_thread)
        with closing(batches), closing(passes):
            yield from passes
    finally:
        torch.set_num_threads(threads)


def perceive_drive(
    path: Path,
    ingest: Path,
    encoder: Path,
    settings: Perception,
    *,
    max_passes: int | None = None,
    advance: Callable[[int], object] | None = None,
) -> Summary:
    """Predict depth and classes of each image of a drive, and write them to a file.

    `path` is ``data/perception/<drive>.h5``, `ingest` the drive's file of that stage, and `encoder`
    the folder of the encoder. `max_passes` is an argument of :func:`run_passes`. `advance` is
    called with the number of frames that were written since its last call. The summary has the
    number of frames, and facts as text: the size of what was read, and the shares of the classes.
    """
    opened = open_encoder(encoder, settings.precision)
    with open_ingest(ingest) as source:
        params = source.params | {
            "encoder": {"sha256": file_hash(encoder / FILE)},
            "perception": settings.model_dump(),
        }
        camera = read_camera(source)
        rows = np.flatnonzero(source["has_image"])
        batch_size = settings.batch
        if torch.cuda.is_available():
            batch_size = max(settings.batch, GPU_BATCH)
        batches = read_batches(source, camera, rows, size=batch_size)
        with create_perception(path, drive=source.drive, params=params) as file:
            # The scale of depth is judged by the camera's height, so that must be known.
            file.attrs["unit_error"] = opened.unit_error if camera.height_known else np.inf
            file.put("frame", source.frame[rows])
            file.put("time_s", source.time_s[rows], UNITS["time_s"])
            file.append("depth_m", np.empty((0, *camera.size), np.uint16), UNITS["depth_m"])
            file.append("cls", np.empty((0, *camera.size), np.uint8), UNITS["cls"])
            # Number of pixels by class.
            pixels = np.zeros(classes.VOID + 1, np.int64)

            # A thread reads images, other threads run the network, and this thread writes.
            with closing(run_passes(opened.predict, batches, max_passes)) as results:
                for depth_m, cls in results:
                    file.append("depth_m", to_units(np.where(cls == classes.SKY, 0, depth_m)))
                    file.append("cls", cls)
                    pixels += np.bincount(cls.ravel(), minlength=len(pixels))
                    if advance:
                        advance(len(cls))
        # Files of a drive have the size of those of its first frame.
        facts = ""
        if len(rows):
            height, width = camera.size
            size = f"as ingested: {width} × {height}"
            if opened.files:
                frame = int(source.frame[rows[0]])
                size = precomputed.describe_sizes(opened.files, source.drive, frame, camera)
            facts = f", {size}, {class_shares(pixels)}"
    return {"frames": len(rows), "facts": facts}


def class_shares(pixels: np.ndarray) -> str:
    """Return the shares of the most frequent classes as text.

    `pixels` [256] are the numbers of pixels by trainId.
    """
    names = {classes.VOID: "void", **dict(enumerate(classes.NAMES))}
    texts = []
    for number in np.argsort(-pixels, kind="stable")[:SHARES].tolist():
        if pixels[number]:
            # Files of precomputed classes may have other numbers than trainIds.
            name = names.get(number, f"class {number}")
            texts.append(f"{name} {100 * pixels[number] / pixels.sum():.0f} %")
    if np.count_nonzero(pixels) > SHARES:
        texts.append("…")
    return ", ".join(texts)


def read_batches(
    source: DriveReader, camera: Camera, rows: np.ndarray, size: int
) -> Generator[EncoderInput]:
    """Yield the frames in `rows` of a file of stage ingest, in batches of `size`."""
    for start in range(0, len(rows), size):
        batch = rows[start : start + size]
        # Images are read row by row, since a slice would include frames without an image.
        images = np.stack([source.row("image", row) for row in batch])
        yield EncoderInput(source.drive, source.frame[batch], images, camera)
