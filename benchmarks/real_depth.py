"""Depth and classes of real drives by one small network, each drive judged by an encoder that was fitted to the others.

The encoder of ``presets/real.yaml`` stands beside ESPNetv2, whose depth head is fitted to the other drives' scans, and
flat ground under ESPNetv2's classes. Its classes are compared with ESPNetv2's, which taught them on the other drives.
Depth is what stage perception stores, with the preset's ``reach``, against those points of scans that the camera sees.
"""

import contextlib
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
import yaml

from pipeline.base import console, store
from pipeline.base.errors import InputError, closest
from pipeline.camera import classes
from pipeline.encoder import perceive
from pipeline.motion import kinds as motion_kinds
from pipeline.sections.preset import merged
from stages import encoder, ingest, perception, scores

FULL_SIZE = "2012_01_01_drive_0052"  # a date of its own, for a calibration of its own; KITTI's is 2011_09_26
DRIVES = (
    *("2011_09_26_drive_0005", "2011_09_26_drive_0039", "2011_09_26_drive_0095", "2011_10_03_drive_0042"),
    FULL_SIZE,
)
ESPNETV2 = {"backbone": "espnetv2", "teacher": None, "epochs": 2, "frames": 40, "learning_rate": 0.001}
ERRORS = ("abs_rel", "delta1")
CROPS = {"whole image": "", "Eigen's crop": "_eigen"}
KINDS = (classes.GROUND, classes.TRAFFIC, (classes.SKY,))  # and all that is built or grows


class Row(NamedTuple):
    """A drive's figures: of depth, [abs rel, δ1] by crop and network; of classes, the share of equal pixels by frame.

    `classes` and `kinds` [F] compare our network with ESPNetv2, `mirrored` [F] ESPNetv2 with what it sees in a mirror.
    """

    depth: dict[str, dict[str, list[float]]]
    classes: np.ndarray
    kinds: np.ndarray
    mirrored: np.ndarray


def main(
    half: Annotated[Path, typer.Argument(metavar="HALF_ROOT", help="KITTI raw's layout, half size: 0005, 0039, …")],
    kitti: Annotated[Path, typer.Argument(metavar="KITTI_ROOT", help="KITTI raw's layout: 0052")],
    drives: Annotated[list[str] | None, typer.Argument(metavar="DRIVE", help="judge these alone: 0005, …")] = None,
    preset: Annotated[str, typer.Option(help="whose encoder and image size: a name in presets/, or a file")] = "real",
    frames: Annotated[int | None, typer.Option(min=1, help="to fit to, instead of the preset's")] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="instead of the preset's")] = None,
) -> None:
    """Leave each drive out, fit to the others, judge it, and print Markdown tables."""
    judged = [_named(drive) for drive in drives] if drives else list(DRIVES)
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stdout(sys.stderr):
        folder = Path(scratch)
        lay_out(half.resolve(), kitti.resolve(), folder / "raw")
        content = merged(preset)
        everything = {"train": list(DRIVES[1:]), "val": [], "test": [DRIVES[0]]}
        content["ingest"] |= {"source": "kitti", "cameras": [2, 0], "lidar": True, "drives": everything}
        changes = {"frames": frames, "epochs": epochs}
        content["encoder"] |= {key: value for key, value in changes.items() if value is not None}
        # The preset teaches classes on all drives, as an image needs no label. Here that is what is judged.
        content["encoder"]["teacher"]["drives"] = "train"
        ingested = ingest.main(folder / "town", folder / "raw", folder / "ingest", _write(content, folder / "all.yaml"))
        rows = {drive: judge(drive, ingested, content, folder / drive) for drive in judged}
    print(depth_table(rows), class_table(rows), sep="\n\n")


def _named(number: str) -> str:
    for drive in DRIVES:
        if drive.endswith(f"_{number}"):
            return drive
    raise InputError(f"there is no drive {number!r}: {closest(number, [drive[-4:] for drive in DRIVES])}")


def _write(content: Mapping[str, Any], path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(dict(content)), encoding="utf-8")
    return path


def lay_out(half: Path, kitti: Path, raw: Path) -> None:
    """Link the drives and their calibrations into `raw`, as KITTI lays them out. Raises InputError without one."""
    for drive in DRIVES:
        root, name = (kitti, f"2011_09_26{drive[10:]}") if drive == FULL_SIZE else (half, drive)
        source = root / name[:10] / f"{name}_sync"
        if not source.is_dir():
            raise InputError(f"{source} is missing: extract it there")
        date = raw / drive[:10]
        date.mkdir(parents=True, exist_ok=True)
        (date / f"{drive}_sync").symlink_to(source)
        for path in source.parent.glob("calib_*.txt"):
            if not (date / path.name).exists():
                (date / path.name).symlink_to(path)


def judge(drive: str, ingested: Path, content: Mapping[str, Any], folder: Path) -> Row:
    """Fit the encoder of `content` and ESPNetv2 to all drives in `ingested` but one, and compare them on that one."""
    ours = content["encoder"]
    networks = {"ours": ours, "espnetv2": ours | ESPNETV2 | {"weights": ours["teacher"]["weights"]}}
    depth: dict[str, dict[str, list[float]]] = {crop: {} for crop in CROPS}
    cls = []
    for name, settings in networks.items():
        params, out = _write({**content, "encoder": settings}, folder / f"{name}.yaml"), folder / name
        store.write_index(ingested, {other: "test" if other == drive else "train" for other in DRIVES})
        fitted = encoder.main(ingested, out / "encoder", params)
        store.write_index(ingested, {drive: "test"})
        perceived = perception.main(ingested, fitted, out / "perception", params)
        motion_kinds.write(out / "motion", [])
        scored = scores.main(ingested, perceived, out / "motion", out / "scores", params)
        report = store.read_json(scored / "metrics.json", stage="scores")
        for key, of in (("depth_lidar", name), ("ground_plane_lidar", "flat")):
            for crop, suffix in CROPS.items():
                if found := report["test"][key + suffix]:
                    depth[crop][of] = [found[error] for error in ERRORS]
        with store.DriveReader(perceived / f"{drive}.h5", stage="perception") as file:
            cls.append(file["cls"])
    mirror = classes_in_a_mirror(ingested / f"{drive}.h5", fitted)
    return Row(depth, agreement(*cls), agreement(*map(kinds, cls)), agreement(mirror, cls[1]))


def classes_in_a_mirror(ingested: Path, fitted: Path) -> np.ndarray:
    """Return the trainIds [F,H,W] that a fitted encoder sees in a drive's mirrored images, mirrored back."""
    model = perceive.load(fitted)
    with store.DriveReader(ingested, stage="ingest") as file:
        rows, K = np.flatnonzero(file["has_image"]), file["K"]
        mirrored = (np.ascontiguousarray(file.row("image", int(row))[None, :, ::-1]) for row in rows)
        return np.concatenate([perceive.perceive(model, image, K)[1][:, :, ::-1] for image in mirrored])


def kinds(cls: np.ndarray) -> np.ndarray:
    """Return for trainIds which of KINDS they are, 255 for void: what depth, motion and graphs tell apart."""
    table = np.full(256, len(KINDS), np.uint8)
    for kind, members in enumerate(KINDS):
        table[list(members)] = kind
    table[classes.VOID] = classes.VOID
    return table[cls]


def agreement(cls: np.ndarray, teacher: np.ndarray) -> np.ndarray:
    """Return the share of a frame's pixels [F] whose trainIds [F,H,W] are the teacher's, of those that it names."""
    known = teacher != classes.VOID
    return ((cls == teacher) & known).sum(axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)


def depth_table(rows: Mapping[str, Row]) -> str:
    """Return the errors of depth on drives with scans, as Markdown."""
    beside = "ESPNetv2's", "flat ground's"
    lines = [["left out", "of the", "abs rel", *beside, "δ1", *beside], ["---", "---", *["--:"] * 6]]
    for drive, row in rows.items():
        for crop, depth in row.depth.items():
            if depth:
                figures = [depth[of][error] for error in range(len(ERRORS)) for of in ("ours", "espnetv2", "flat")]
                lines.append([drive[-4:], crop, *_printed(figures)])
    return _markdown(lines)


def class_table(rows: Mapping[str, Row]) -> str:
    """Return the shares of pixels that are of ESPNetv2's classes, as Markdown."""
    head = ["left out", "images", "classes as ESPNetv2's", "worst frame", "kinds", "ESPNetv2 mirrored"]
    lines = [head, ["---", *["--:"] * 5]]
    for drive, row in rows.items():
        shares = [row.classes.mean(), row.classes.min(), row.kinds.mean(), row.mirrored.mean()]
        lines.append([drive[-4:], str(len(row.classes)), *_printed(shares)])
    return _markdown(lines)


def _printed(figures: Sequence[float]) -> list[str]:
    return [f"{figure:.3f}" for figure in figures]


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


if __name__ == "__main__":
    console.run(main)
