"""Stage encoder: fit the unified encoder on the training drives, or take fitted weights."""

from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import Job, make_drives
from pipeline.encoder import encoder_file
from pipeline.encoder.create import create
from pipeline.encoder.fit import fit_drives
from pipeline.encoder.settings import Encoder
from pipeline.ingest.settings import Ingest


def main(
    data: Path = Path("data"), out: Path = Path("data/encoder"), params: Path = Path("params.yaml")
) -> Path:
    """Write encoder.pt, config.json and curve.csv. Return the folder."""
    settings, ingest = load(Encoder, params), data / "ingest"
    config: dict[str, Any] = settings.model_dump(
        mode="json", exclude_none=True, exclude={"weights_sha256"}
    )
    with stage_folder("encoder", out, params=params) as stage:
        torch.manual_seed(settings.seed)
        with error_context(params), error_context("encoder"):
            architecture, model = create(settings)
        size = load(Ingest, params).image_size
        with (
            error_context(params),
            error_context(f"backbone {settings.backbone}, ingest.image_size {list(size)}"),
        ):
            if settings.backbone != "precomputed":
                encoder_file.check_size(model, size)
        curve: list[dict[str, float]] = []
        if settings.epochs:
            encoder_file.save(stage.kept / "start", architecture, model.state_dict())
            drives = store.drives_in(store.read_index(ingest, stage="ingest"), "train")
            inputs: list[Path | str] = [
                stage.kept / "start" / encoder_file.FILE,
                *(ingest / f"{d}.h5" for d in drives),
            ]
            work = partial(
                fit_drives,
                model=model,
                architecture=architecture,
                settings=settings,
                ingest=ingest,
                drives=drives,
            )
            job = Job("encoder", encoder_file.FILE, inputs, work)
            fitted = make_drives(stage, [job], settings, "{frames} frames", workers=1)["encoder"]
            curve = fitted["curve"]
            config |= fitted["config"] | {
                "losses": {name: curve[-1][name] for name in ("loss", "depth", "classes")}
            }
        else:
            encoder_file.save(stage.new, architecture, model.state_dict())
        parameters = sum(parameter.numel() for parameter in model.parameters())
        config |= {"sources": architecture.get("sources", []), "parameters": parameters}
        store.write_json(stage.new / "config.json", config)
        table = pd.DataFrame(curve, columns=["epoch", "loss", "depth", "classes"])
        table.to_csv(stage.new / "curve.csv", index=False, float_format="%.6g", lineterminator="\n")
    frames = sum(config.get("frames_per_drive", {}).values())
    action = f"fitted on {frames} frames" if curve else "weights used as they are"
    for line in (f"{settings.backbone}, {parameters:,} parameters, {action}", *config["sources"]):
        print(f"encoder: {line}", flush=True)
    return out


if __name__ == "__main__":
    console.run(main)
