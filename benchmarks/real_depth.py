"""A depth head fitted to some seconds of LiDAR, beside flat ground under the same classes, on frames it has not seen.

What there is of real drives is laid out anew in a scratch folder, by links, as drives of KITTI raw; the stages do the
rest.
"""

import contextlib
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.camera.png import read_png
from pipeline.kitti.oxts import COLUMNS
from pipeline.perception.scores import DEPTH_ERRORS
from pipeline.sections.preset import merged
from stages import encoder, ingest, perception, scores

DATE = "2011_09_26"
FITTED, HELD_OUT, ELSEWHERE = f"{DATE}_drive_0052", f"{DATE}_drive_9052", f"{DATE}_drive_0001"
OBJECTS = {f"2012_01_0{day}_drive_0000": f"{day - 1:06d}" for day in (1, 2, 3)}  # a date each: each has its calibration
PLACES = {
    FITTED: "0052, frames 0 to 39: fitted",
    HELD_OUT: "0052, frames 40 to 47: held out",
    **{drive: f"object {number}" for drive, number in OBJECTS.items()},
    ELSEWHERE: "0001, frame 5",
}
UNSEEN = (*OBJECTS, ELSEWHERE)  # other streets
Row = tuple[int, float, np.ndarray, np.ndarray]
"""Frames, coverage, and the errors of the depth head and of flat ground, [3] each as DEPTH_ERRORS."""


def main(
    kitti: Annotated[Path, typer.Argument(metavar="KITTI_ROOT", help=f"holds {DATE}/ and object/")],
    preset: Annotated[str, typer.Option(help="a name in presets/, or a file")] = "real",
    image_size: Annotated[tuple[int, int] | None, typer.Option(metavar="H W", help="instead of the preset's")] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="instead of the preset's")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="instead of the preset's")] = None,
) -> None:
    """Fit the depth head to 40 frames of drive 0052, score it on others, and print a Markdown table."""
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stdout(sys.stderr):
        folder = Path(scratch)
        lay_out(kitti.resolve(), folder / "raw")
        content = merged(preset)
        drives = {"train": [FITTED], "test": [HELD_OUT, *UNSEEN]}
        content["ingest"] |= {"source": "kitti", "cameras": [2], "drives": drives}
        if image_size:
            content["ingest"]["image_size"] = list(image_size)
        changes = {"epochs": epochs, "learning_rate": learning_rate}
        content["encoder"] |= {key: value for key, value in changes.items() if value is not None}
        chosen = folder / "params.yaml"
        chosen.write_text(yaml.safe_dump(content), encoding="utf-8")
        ingested = folder / "ingest"
        ingest.main(folder / "town", folder / "raw", ingested, chosen)
        fitted = encoder.main(ingested, folder / "encoder", chosen)
        perceived = perception.main(ingested, fitted, folder / "perception", chosen)
        rows = read(scores.main(ingested, perceived, folder / "scores"))
    print(table(rows))


def lay_out(kitti: Path, raw: Path) -> None:
    """Link the frames that the experiment is about into `raw`, in KITTI raw's layout. Raises InputError without one."""
    for path in (kitti / DATE).glob("calib_*.txt"):
        _link(path, raw / DATE / path.name)
    frames = {FITTED: (FITTED, range(40)), HELD_OUT: (FITTED, range(40, 48)), ELSEWHERE: (ELSEWHERE, [5])}
    for drive, (source, numbers) in frames.items():
        _link_drive(kitti / DATE / f"{source}_sync", raw / DATE / f"{drive}_sync", numbers)
    for drive, number in OBJECTS.items():
        _link_object(kitti / "object", number, raw / drive[:10] / f"{drive}_sync")


def _link_drive(source: Path, target: Path, numbers: Iterable[int]) -> None:
    _link(source / "oxts/timestamps.txt", target / "oxts/timestamps.txt")
    for number in numbers:
        for name in ("image_02/data/{}.png", "velodyne_points/data/{}.bin", "oxts/data/{}.txt"):
            file = name.format(f"{number:010d}")
            _link(source / file, target / file)


def _link_object(source: Path, number: str, target: Path) -> None:
    """Make a frame of KITTI's object set a drive with its own calibration; it has no oxts, so zeros stand for them."""
    image = target / "image_02/data/0000000000.png"
    _link(source / f"image_2/{number}.png", image)
    _link(source / f"velodyne/{number}.bin", target / "velodyne_points/data/0000000000.bin")
    _link(source / f"calib/{number}.txt", target / "object_calib.txt")
    lines = (target / "object_calib.txt").read_text(encoding="ascii").splitlines()
    words = {name: values.split() for name, values in (line.split(":") for line in lines if line)}
    height, width = read_png(image).shape[:2]
    Tr = np.array(words["Tr_velo_to_cam"]).reshape(3, 4)
    _write_calibration(
        target.parent / "calib_cam_to_cam.txt",
        {"S_rect_02": [str(width), str(height)], "R_rect_00": words["R0_rect"], "P_rect_02": words["P2"]},
    )
    _write_calibration(target.parent / "calib_velo_to_cam.txt", {"R": Tr[:, :3].ravel(), "T": Tr[:, 3]})
    (target / "oxts/data").mkdir(parents=True)
    (target / "oxts/data/0000000000.txt").write_text(" ".join(["0"] * len(COLUMNS)) + "\n", encoding="ascii")
    (target / "oxts/timestamps.txt").write_text("2012-01-01 00:00:00.000000000\n", encoding="ascii")


def _write_calibration(path: Path, entries: Mapping[str, Iterable[str]]) -> None:
    path.write_text("".join(f"{key}: {' '.join(values)}\n" for key, values in entries.items()), encoding="ascii")


def _link(source: Path, target: Path) -> None:
    if not source.is_file():
        raise InputError(f"{source} is missing: extract it there, from KITTI raw or KITTI's object set")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.symlink_to(source)


def read(folder: Path) -> dict[str, Row]:
    """Return drive → the means over its frames, against LiDAR, out of what stage scores wrote to `folder`."""
    rows = {}
    for drive in PLACES:
        report = store.read_json(folder / drive / "metrics.json", stage="scores")
        depth, flat = report["depth_lidar"], report["ground_plane_lidar"]
        rows[drive] = (depth["frames"], depth["coverage"], _errors(depth), _errors(flat))
    return rows


def _errors(means: Mapping[str, Any]) -> np.ndarray:
    return np.array([means[name] for name in DEPTH_ERRORS])


def table(rows: Mapping[str, Row]) -> str:
    """Return the rows as Markdown, and a last one with the mean over the frames of other streets."""
    head = ["against LiDAR, 1 to 80 m", "frames", "coverage"]
    for name in ("abs rel", "RMSE m", "δ1"):
        head += [name, "flat ground's"]
    lines = [head, ["---", *["--:"] * (len(head) - 1)]]
    lines += [_cells(PLACES[drive], *row) for drive, row in rows.items()]
    _, *columns = zip(*(rows[drive] for drive in UNSEEN), strict=True)
    lines.append(_cells("**mean of other streets**", len(UNSEEN), *(np.mean(column, axis=0) for column in columns)))
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _cells(name: str, frames: int, coverage: float, head: np.ndarray, flat: np.ndarray) -> list[str]:
    pairs = zip(head, flat, (3, 2, 3), strict=True)
    return [name, str(frames), f"{coverage:.1%}", *(f"{value:.{digits}f}" for *pair, digits in pairs for value in pair)]


if __name__ == "__main__":
    console.run(main)
