"""Show one file of a stage: its content, or its points in 3D."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, replacing
from pipeline.clouds import cloud_file
from pipeline.graphs import graph_file
from pipeline.ingest import ingest_file
from pipeline.labels import label_file
from pipeline.motion import motion_file
from pipeline.perception import perception_file

Content = dict[str, Any]
# Modules that describe the files of the stages.
FORMATS = (ingest_file, perception_file, motion_file, label_file, cloud_file, graph_file)
# Largest number of values in a list of a checkpoint that are all shown.
LONGEST_LIST = 10


def describe_file(path: Path) -> Content:
    """Return a drive's file or a checkpoint as plain values.

    Raises InputError if it is missing, damaged or another kind of file.
    """
    if path.suffix == ".pt":
        from pipeline.base import checkpoint

        loaded = checkpoint.load(path)
        return {"bytes": path.stat().st_size, **_without_tensors(loaded)}

    with open_drive(path) as file:
        content: Content = {"bytes": path.stat().st_size}
        for name in sorted(file.attrs):
            if name != "params":
                content[name] = np.asarray(file.attrs[name]).tolist()
        frames = file.frame.tolist()
        content["frames"] = f"{len(frames)}, {frames[0]} to {frames[-1]}" if frames else "0"
        content["datasets"] = {name: _describe_dataset(file, name) for name in file.datasets}
        content["settings"] = file.params
        return content


def _describe_dataset(file: DriveReader, name: str) -> list[str]:
    """Return texts about a dataset: type and shape, unit, pointers, size on disk, meaning."""
    dataset = file.datasets[name]
    shape = " × ".join(str(size) for size in dataset.shape)
    texts = [f"{dataset.dtype} {shape}"]
    if file.units.get(name):
        texts.append(file.units[name])
    if name in file.pointers:
        texts.append(f"rows of a frame: {file.pointers[name]}")
    texts.append(f"{dataset.id.get_storage_size()} bytes")
    if name in file.meanings:
        texts.append(file.meanings[name])
    return texts


def write_view(path: Path, number: int | None, out: Path) -> None:
    """Write a page with the points and edges of a frame of a file in 3D.

    The page has the frame's image, too, if it is in the same data folder. If `number` is None, it
    is the frame in the middle of the file. Raises InputError if the file has no points, or lacks
    the frame.
    """
    from pipeline.report.street_view import read_view
    from steer import space

    with open_drive(path) as file:
        if "xyz" not in file or not len(file["xyz"]):
            fix = "Pass a file of point clouds, or of graphs of points"
            raise InputError("has no points", path, fix)
        if number is None:
            number = int(file.frame[len(file.frame) // 2])
        view = read_view(number, file)
        images = open_images(file)
        if images is not None:
            view = view._replace(rgb=read_view(number, images).rgb)
        kind = f"{file.attrs['stage']}/{path.absolute().parent.name}"
        title = f"{file.drive}, {kind}, frame {number}"
    with replacing(out) as unfinished:
        space.write_page(unfinished, view, title)


def open_drive(path: Path) -> DriveReader:
    """Open a drive's file of any stage. Raises InputError for other files."""
    if path.is_dir() or path.suffix != ".h5":
        problem = "expected a drive's file (.h5) or a checkpoint (.pt)"
        raise InputError(problem, path, "Pass one from a folder in data/")
    return DriveReader(path, {file.STAGE: file.VERSIONS for file in FORMATS})


def open_images(file: DriveReader) -> DriveReader | None:
    """Open the drive's file of stage ingest in the same data folder; None if it is not there.

    `file` is in data/clouds/KIND or data/graphs/VARIANT. Both files are closed together.
    """
    # The folder is resolved without the file, which DVC may have linked to its cache.
    data = file.path.parent.resolve().parent.parent
    ingest = data / "ingest" / file.path.name
    if not ingest.is_file():
        return None
    return file.enter_context(ingest_file.open_ingest(ingest))


def _without_tensors(content: Mapping[str, Any]) -> Content:
    """Return the plain values of a checkpoint.

    Tensors and empty mappings are left out. Of long lists, such as those of drives, the ends stay.
    """
    plain = {}
    for name, value in content.items():
        if hasattr(value, "detach"):
            continue
        if isinstance(value, Mapping):
            value = _without_tensors(value)
        elif isinstance(value, list) and len(value) > LONGEST_LIST:
            value = f"{len(value)}: {value[0]} to {value[-1]}"
        if value != {}:
            plain[name] = value
    return plain
