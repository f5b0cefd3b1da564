"""Steering labels from oxts, and a summary of how plausible they are."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from pipeline import label
from pipeline.base import console, store
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.base.runner import run_over_drives
from pipeline.kitti.oxts import VF, VL, WU
from pipeline.sections.labels import Labels


def main(
    ingest: Path = Path("data/ingest"),
    out: Path = Path("data/labels"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Compute the steering angle of each frame (paper section 4.1) and say which frames have a usable one.

    Returns the folder that it wrote.
    """
    settings = load(Labels, params)
    splits = store.read_index(ingest, stage="ingest")
    summaries = run_over_drives(
        partial(label_drive, ingest=ingest, settings=settings),
        list(splits),
        out=out,
        key=lambda drive: stage_key(
            "labels", {"drive": drive, **settings.model_dump(mode="json")}, [ingest / f"{drive}.h5"]
        ),
        workers=1,  # less work than starting a process
        describe=describe,
    )
    store.write_json(out / "summary.json", summaries)
    store.write_index(out, splits)
    suspect = [drive for drive, summary in summaries.items() if summary["sideways_frames"]]
    if suspect:
        print(f"labels in doubt, oxts says that the car slides sideways: {', '.join(suspect)}")
    return out


def label_drive(drive: str, path: Path, ingest: Path, settings: Labels) -> dict[str, Any]:
    """Write one drive's labels and return their plausibility summary."""
    with store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw:
        frame, time_s, oxts = raw.frame, raw.time_s, raw["oxts"]
    speed_mps, yaw_rate_radps = oxts[:, VF], oxts[:, WU]
    steering_rad, valid = label.steering_labels(
        yaw_rate_radps,
        speed_mps,
        wheelbase_m=settings.wheelbase_m,
        min_speed_mps=settings.min_speed_mps,
        standstill=settings.standstill,
    )
    with store.DriveWriter(path, stage="labels", drive=drive, params={"labels": settings.model_dump()}) as file:
        label.write(
            file,
            frame,
            time_s,
            steering_rad=steering_rad,
            valid=valid,
            speed_mps=speed_mps,
            yaw_rate_radps=yaw_rate_radps,
            wheelbase_m=settings.wheelbase_m,
        )
    return label.plausibility(steering_rad, valid, speed_mps, oxts[:, VL], time_s)


def describe(summary: Mapping[str, Any]) -> str:
    """Return what the log says of one drive."""
    text = "{frames} frames, {valid_share:.0%} valid".format_map(summary)
    if summary["valid_share"]:
        text += (
            ", |steering| mean {mean_abs_steering_rad:.4f} max {max_abs_steering_rad:.3f} rad, "
            "zero-MSE {zero_mse_rad2:.5f} rad²"
        ).format_map(summary)
    for kind in ("reversing", "sideways"):
        if summary[f"{kind}_frames"]:
            text += f", {summary[f'{kind}_frames']} {kind}"
    if summary["frames"] > 1:
        text += ", dt {dt_mean_s:.4f} ± {dt_std_s:.4f} s".format_map(summary)
    return text


if __name__ == "__main__":
    console.run(main)
