"""Stage encoder: fit the unified encoder's parts on the training drives, or take what was fitted elsewhere."""

import csv
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.base import console, store
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.lock import exclusive
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.encoder import precomputed
from pipeline.encoder.weights import Source, fill, unnamed
from pipeline.sections.encoder import PARTS, Encoder

Fitted = tuple[Sequence[Any], dict[str, Any]]


def main(
    ingest: Path = Path("data/ingest"),
    out: Path = Path("data/encoder"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write encoder.pt, config.json, curve.csv; return the folder. Opens training drives, or all if a teacher may."""
    settings = load(Encoder, params)
    kept = out.parent / ".resume" / out.name
    if settings.backbone == precomputed.BACKBONE:
        with exclusive(out, kept):
            return _take_precomputed(settings, out)
    splits = store.read_index(ingest, stage="ingest")
    drives = {drive: split for drive, split in splits.items() if split in settings.splits}

    import torch

    from models.encoder.unified_encoder import UnifiedEncoder
    from pipeline.encoder import perceive

    torch.manual_seed(settings.seed)
    with error_context(str(params)):
        with error_context("encoder.backbone"):
            model = UnifiedEncoder(settings.backbone)
        sources = fill(model, settings.backbone, settings.weights, "encoder.weights")
        part = unnamed(model, settings.weights, PARTS)
        if part and not settings.epochs:
            raise InputError(f"encoder.weights names no {part}: name one, or let encoder.epochs fit it")

    curve: Sequence[Any] = []
    trained_on: dict[str, Any] = {"frames_per_drive": {}, "image_size": None}
    with exclusive(out, kept):
        if settings.epochs:
            curve, trained_on = _fit(model, settings, sources, ingest, drives, kept)
        perceive.save(out, settings.backbone, model.state_dict())
        config = settings.model_dump(mode="json") | trained_on | {
            "sources": [asdict(source) for source in sources],
            "losses": {name: getattr(curve[-1], name) for name in ("loss", "depth", "classes")} if curve else None,
            "parameters": sum(parameter.numel() for parameter in model.parameters()),
        }  # fmt: skip
        store.write_json(out / "config.json", config)
        with replacing(out / "curve.csv") as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["epoch", "loss", "depth", "classes"])
            rows.writerows([row.epoch, f"{row.loss:.6g}", f"{row.depth:.6g}", f"{row.classes:.6g}"] for row in curve)
        shutil.rmtree(kept, ignore_errors=True)
    frames = sum(trained_on["frames_per_drive"].values())
    print(
        f"encoder: {settings.backbone}, {config['parameters']:,} parameters, "
        + (f"fitted on {frames} frames of {len(drives)} drives" if curve else "weights used as they are")
        + (f", starting from {', '.join(source.path for source in sources)}" if sources and curve else ""),
        flush=True,
    )
    return out


def _fit(
    model: Any, settings: Encoder, weights: list[Source], ingest: Path, drives: dict[str, str], kept: Path
) -> Fitted:
    """Fit what something teaches; of drives that are not for training, to their images alone.

    Returns the curve, and what config.json says of the frames.
    """
    import torch

    from pipeline.encoder import fit, teach
    from pipeline.encoder.examples import Examples

    teacher, taught_by = None, list[Source]()
    if given := settings.teacher:
        teacher, taught_by = teach.load_teacher(given.backbone, given.weights, given.key)
    hashes = [source.sha256 for source in (*weights, *taught_by)]
    files = [ingest / f"{drive}.h5" for drive in drives]
    key = stage_key("encoder", settings.model_dump(mode="json"), [*hashes, *files])
    untold = [drive for drive, split in drives.items() if split != "train"]
    with Examples(ingest, list(drives), settings.frames, teacher, untold) as examples:
        lessons = teach.choose(model, settings.weights, examples.known, teacher=examples.taught, frozen=settings.frozen)
        print(f"encoder: {', '.join(f'{head} by {lesson}' for head, lesson in lessons.items())}", flush=True)
        curve = fit.fit(
            model.to("cuda" if torch.cuda.is_available() else "cpu"),
            examples,
            epochs=settings.epochs,
            batch=settings.batch,
            learning_rate=settings.learning_rate,
            seed=settings.seed,
            kept=kept / f"{key}.pt",
        )
        return curve, {"frames_per_drive": examples.frames_per_drive, "image_size": list(examples.size)}


def _take_precomputed(settings: Encoder, out: Path) -> Path:
    files, fingerprint = precomputed.fingerprint(Path(str(settings.weights)))
    config = settings.model_dump(mode="json") | {"files": files, "fingerprint": fingerprint}
    store.write_json(out / "config.json", config)
    print(f"encoder: {files} precomputed files in {settings.weights}", flush=True)
    return out


if __name__ == "__main__":
    console.run(main)
