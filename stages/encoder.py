"""Stage encoder: fit the unified encoder on the training drives, or take one that was fitted elsewhere."""

import csv
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline import checkpoint, console, store
from pipeline.drives import resume_key
from pipeline.errors import InputError
from pipeline.params import load
from pipeline.sections.encoder import Encoder
from pipeline.weights import find_weights, read_weights, write_weights

MEND = "Name another file in encoder.weights, or set it to null to fit from the start"


def main(
    ingest: Path = Path("data/ingest"),
    out: Path = Path("data/encoder"),
    params: Path = Path("params.yaml"),
) -> None:
    """Write encoder.pt, config.json and curve.csv. Only the drives of split train are opened."""
    settings = load(Encoder, params)
    drives = store.of_split(store.read_index(ingest, stage="ingest"), "train")
    source = find_weights(settings.weights) if settings.weights else None

    import torch

    from models.unified_encoder import BACKBONES, UnifiedEncoder

    if settings.backbone not in BACKBONES:
        raise InputError(f"{params}: encoder.backbone = {settings.backbone}: known: {', '.join(BACKBONES)}")
    torch.manual_seed(settings.seed)
    model = UnifiedEncoder(settings.backbone)
    if source:
        weights = read_weights(source[0], MEND)
        if weights.backbone != settings.backbone:
            raise InputError(
                f"{source[0]} holds backbone {weights.backbone!r}, encoder.backbone is {settings.backbone!r}. {MEND}"
            )
        checkpoint.load_state(model, weights.state, source[0], MEND)

    curve: Sequence[Any] = []
    supervision: dict[str, Any] = {"frames_per_drive": {}, "image_size": None}
    kept = out.parent / ".resume" / out.name
    if settings.epochs:
        from pipeline.encoder_fit import fit
        from pipeline.supervision import Supervision

        files = [ingest / f"{drive}.h5" for drive in drives]
        key = resume_key("stages.encoder", settings.model_dump(), [source[1] if source else "", *files])
        with Supervision(ingest, drives, settings.frames) as examples:
            if not examples.has_classes and not settings.frozen:
                print(
                    "note: no training drive has class truth: the class head stays as it is on a backbone that moves. "
                    "encoder.frozen: true keeps the classes of encoder.weights",
                    flush=True,
                )
            model.backbone.requires_grad_(not settings.frozen)
            supervision = {"frames_per_drive": examples.frames_per_drive, "image_size": list(examples.size)}
            curve = fit(
                model.to("cuda" if torch.cuda.is_available() else "cpu"),
                examples,
                epochs=settings.epochs,
                batch=settings.batch,
                learning_rate=settings.learning_rate,
                seed=settings.seed,
                kept=kept / f"{key}.pt",
            )

    write_weights(out / "encoder.pt", settings.backbone, model.state_dict())
    config = settings.model_dump(mode="json") | supervision | {
        "weights": {"path": str(source[0]), "sha256": source[1]} if source else None,
        "losses": {name: getattr(curve[-1], name) for name in ("loss", "depth", "classes")} if curve else None,
        "parameters": sum(parameter.numel() for parameter in model.parameters()),
    }  # fmt: skip
    store.write_json(out / "config.json", config)
    with (out / "curve.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["epoch", "loss", "depth", "classes"])
        rows.writerows([row.epoch, f"{row.loss:.6g}", f"{row.depth:.6g}", f"{row.classes:.6g}"] for row in curve)
    shutil.rmtree(kept, ignore_errors=True)
    frames = sum(supervision["frames_per_drive"].values())
    print(
        f"encoder: {settings.backbone}, {config['parameters']:,} parameters, "
        + (f"fitted on {frames} frames of {len(drives)} drives" if curve else "weights used as they are")
        + (f", starting from {source[0]}" if source and curve else ""),
        flush=True,
    )


if __name__ == "__main__":
    console.run(main)
