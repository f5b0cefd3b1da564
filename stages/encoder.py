"""Stage encoder: fit the unified encoder on the training drives, or take fitted weights."""

import csv
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.base import console, store
from pipeline.base.errors import InputError, error_context
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.settings.encoder import PARTS, Encoder


def main(
    ingest: Path = Path("data/ingest"), out: Path = Path("data/encoder"), params: Path = Path("params.yaml")
) -> Path:
    """Write encoder.pt, config.json and curve.csv. Return the folder."""
    settings = load(Encoder, params)
    import torch

    from models.encoder.unified_encoder import UnifiedEncoder
    from pipeline.perception import perceive, precomputed
    from pipeline.perception.weights import load_weights, part_without_weights

    if settings.folder:
        files, fingerprint = precomputed.fingerprint(settings.folder)
        config = {"weights": str(settings.folder), "files": files, "fingerprint": fingerprint}
        with stage_folder("encoder", out) as stage:
            store.write_json(stage.new / "config.json", settings.model_dump(mode="json") | config)
        print(f"encoder: {files} precomputed files in {settings.folder}", flush=True)
        return out
    splits = store.read_index(ingest, stage="ingest") if settings.epochs else {}  # fitted weights need no drive
    drives = {drive: split for drive, split in splits.items() if split in settings.splits}
    torch.manual_seed(settings.seed)
    with error_context(params):
        with error_context("encoder.backbone"):
            model = UnifiedEncoder(settings.backbone)
        with error_context("encoder.weights"):
            sources = load_weights(model, settings.backbone, settings.weights)
            if not settings.epochs and (part := part_without_weights(model, settings.weights, PARTS)):
                raise InputError(f"no file for the {part}", fix="Name one, or fit it with encoder.epochs")
    curve: Sequence[Any] = []
    fitted_on: dict[str, Any] = {"frames_per_drive": {}, "image_size": None}
    with stage_folder("encoder", out) as stage:
        if settings.epochs:
            curve, fitted_on = _fit(model, settings, ingest, drives)
        perceive.save(stage.new, settings.backbone, model.state_dict())
        parameters = sum(parameter.numel() for parameter in model.parameters())
        losses = {name: getattr(curve[-1], name) for name in ("loss", "depth", "classes")} if curve else None
        results = {"sources": [asdict(source) for source in sources], "losses": losses, "parameters": parameters}
        store.write_json(stage.new / "config.json", settings.model_dump(mode="json") | fitted_on | results)
        with (stage.new / "curve.csv").open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["epoch", "loss", "depth", "classes"])
            rows.writerows([row.epoch, f"{row.loss:.6g}", f"{row.depth:.6g}", f"{row.classes:.6g}"] for row in curve)
    frames = sum(fitted_on["frames_per_drive"].values())
    origin = f", starting from {', '.join(source.path for source in sources)}" if sources else ""
    action = f"fitted on {frames} frames of {len(drives)} drives{origin}" if curve else "weights used as they are"
    print(f"encoder: {settings.backbone}, {parameters:,} parameters, {action}", flush=True)
    return out


def _fit(model: Any, settings: Encoder, ingest: Path, drives: dict[str, str]) -> tuple[Sequence[Any], dict[str, Any]]:
    """Fit the parts that have a training target. Of drives outside of the training split, only images are used.

    Returns the loss curve and the frames for config.json.
    """
    import torch

    from pipeline.perception import fit, weights
    from pipeline.perception.examples import Examples

    teacher = weights.load_teacher(settings.teacher) if settings.teacher else None
    unlabelled = [drive for drive, split in drives.items() if split != "train"]
    with Examples(ingest, list(drives), settings.frames, teacher, unlabelled) as examples:
        targets = weights.choose(
            model, settings.weights, examples.ground_truth, teacher=examples.has_teacher, frozen=settings.frozen
        )
        print("\n".join(f"encoder: {head}: {target.value}" for head, target in targets.items()), flush=True)
        curve = fit.fit(
            model.to("cuda" if torch.cuda.is_available() else "cpu"),
            examples,
            epochs=settings.epochs,
            batch=settings.batch,
            learning_rate=settings.learning_rate,
            seed=settings.seed,
        )
        return curve, {"frames_per_drive": examples.frames_per_drive, "image_size": list(examples.size)}


if __name__ == "__main__":
    console.run(main)
