"""Stage encoder: fit the unified encoder's parts on the training drives, or take what was fitted elsewhere."""

import csv
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.resume import resume_key
from pipeline.encoder import precomputed
from pipeline.encoder.weights import Setting, Source, fill, write_weights
from pipeline.sections.encoder import PARTS, Encoder, Teacher

HEADS = ("depth_head", "class_head")


def main(
    ingest: Path = Path("data/ingest"),
    out: Path = Path("data/encoder"),
    params: Path = Path("params.yaml"),
) -> None:
    """Write encoder.pt, config.json and curve.csv. Only the drives of split train are opened."""
    settings = load(Encoder, params)
    if settings.backbone == precomputed.BACKBONE:
        _take_precomputed(settings, out)
        return
    drives = store.of_split(store.read_index(ingest, stage="ingest"), "train")

    import torch

    from pipeline.encoder.examples import Supervision
    from pipeline.encoder.fit import class_teacher, fit

    torch.manual_seed(settings.seed)
    model = _build(settings.backbone, params, "encoder.backbone")
    sources = fill(model, settings.backbone, settings.weights, "encoder.weights")
    given = set(settings.weights) if isinstance(settings.weights, dict) else set()
    model.backbone.requires_grad_(not settings.frozen)
    for head in HEADS:
        getattr(model, head).requires_grad_(head not in given)

    device = "cuda" if torch.cuda.is_available() else "cpu"
    curve: Sequence[Any] = []
    supervision: dict[str, Any] = {"frames_per_drive": {}, "image_size": None}
    kept = out.parent / ".resume" / out.name
    if settings.epochs:
        teach, taught_by = _teacher(settings.teacher, params, device)
        files: list[Path | str] = [ingest / f"{drive}.h5" for drive in drives]
        hashes = [source.sha256 for source in (*sources, *taught_by)]
        key = resume_key("stages.encoder", settings.model_dump(), [*hashes, *files])
        with Supervision(ingest, drives, settings.frames) as examples:
            if not examples.has_depth:
                _keep(model, "depth_head", settings, "depth or LiDAR", "a drive with LiDAR", params)
            if not examples.has_classes and not settings.teacher:
                _keep(model, "class_head", settings, "class truth", "an encoder.teacher", params)
            if not any(parameter.requires_grad for parameter in model.parameters()):
                raise InputError(f"{params}: nothing is left to fit: encoder.epochs: 0 uses the weights as they are")
            supervision = {"frames_per_drive": examples.frames_per_drive, "image_size": list(examples.size)}
            curve = fit(
                model.to(device),
                examples,
                epochs=settings.epochs,
                batch=settings.batch,
                learning_rate=settings.learning_rate,
                seed=settings.seed,
                kept=kept / f"{key}.pt",
                teacher=class_teacher(teach) if teach else None,
            )
    elif given:
        part = _unnamed(model, settings.weights, PARTS)
        if part:
            raise InputError(f"{params}: encoder.weights names no {part}: name one, or let encoder.epochs fit it")

    write_weights(out / "encoder.pt", settings.backbone, model.state_dict())
    config = settings.model_dump(mode="json") | supervision | {
        "sources": [asdict(source) for source in sources],
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
        + (f", starting from {', '.join(source.path for source in sources)}" if sources and curve else ""),
        flush=True,
    )


def _build(backbone: str, params: Path, key: str) -> Any:
    from models.encoder.unified_encoder import UnifiedEncoder

    try:
        return UnifiedEncoder(backbone)
    except ValueError as error:
        raise InputError(f"{params}: {key}: {error}") from error


def _unnamed(model: Any, weights: Setting, parts: Sequence[str]) -> str | None:
    """The first of `parts` that has something to fit and that no file fills; a checkpoint fills all."""
    if isinstance(weights, str):
        return None
    unnamed = (part for part in parts if part not in (weights or {}))
    return next((part for part in unnamed if any(True for _ in getattr(model, part).parameters())), None)


def _keep(model: Any, head: str, settings: Encoder, truth: str, source: str, params: Path) -> None:
    """Without any truth to fit a head to, the head must stay, and be good as it is, with the backbone that it reads."""
    from models.encoder.ground_depth import GroundDepth

    getattr(model, head).requires_grad_(False)
    part = _unnamed(model, settings.weights, (head, "backbone"))
    if part == head and any(isinstance(module, GroundDepth) for module in getattr(model, head).modules()):
        return  # flat ground under the classes, as long as nothing has fitted it
    if part:
        raise InputError(
            f"{params}: no training drive has {truth}, and encoder.weights names no {part}: "
            f"name a fitted one there, or add {source}"
        )
    if not settings.frozen:
        print(
            f"note: no training drive has {truth}: the {head} stays as it is on a backbone that moves. "
            "encoder.frozen: true keeps what encoder.weights gives",
            flush=True,
        )


def _teacher(settings: Teacher | None, params: Path, device: str) -> tuple[Any, list[Source]]:
    if settings is None:
        return None, []
    model = _build(settings.backbone, params, "encoder.teacher.backbone")
    part = _unnamed(model, settings.weights, ("backbone", "class_head"))
    if part:
        raise InputError(f"{params}: encoder.teacher.weights names no {part}, and nothing fits a teacher: name one")
    sources = fill(model, settings.backbone, settings.weights, "encoder.teacher.weights")
    return model.to(device).eval().requires_grad_(False), sources


def _take_precomputed(settings: Encoder, out: Path) -> None:
    files, fingerprint = precomputed.fingerprint(Path(str(settings.weights)))
    config = settings.model_dump(mode="json") | {"files": files, "fingerprint": fingerprint}
    store.write_json(out / "config.json", config)
    print(f"encoder: {files} precomputed files in {settings.weights}", flush=True)


if __name__ == "__main__":
    console.run(main)
