"""Stage encoder: fit the unified encoder on the training drives, or take fitted weights."""

from functools import partial
from pathlib import Path

import pandas as pd
import torch

from pipeline.jobs import console
from pipeline.jobs.outputs import StageFolder, stage_folder
from pipeline.jobs.runner import Job, make_drives

from models.encoder.unified_encoder import Architecture
from pipeline.base import store
from pipeline.base.errors import error_context
from pipeline.base.params import load_section
from pipeline.base.summary import Summary
from pipeline.encoder import encoder_file
from pipeline.encoder.create import create_encoder
from pipeline.encoder.fit import fit_drives
from pipeline.encoder.settings import Encoder
from pipeline.ingest.settings import Ingest

# Columns of curve.csv beside the epoch: the mean losses of an epoch.
LOSSES = ("loss", "depth", "classes")


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Write encoder.pt, config.json and curve.csv. Return the folder."""
    out = data / "encoder"
    settings = load_section(Encoder, params)
    size = load_section(Ingest, params).image_size
    config = settings.model_dump(mode="json", exclude_none=True, exclude={"weights_sha256"})
    curve: list[dict[str, float]] = []
    with stage_folder("encoder", out, params=params) as folder:
        # Layers without fitted weights start at random.
        torch.manual_seed(settings.seed)
        with error_context(params), error_context("encoder"):
            architecture, model = create_encoder(settings)

        # A network that does not take images of this size fails here, before any drive is read.
        where = f"backbone {settings.backbone}, ingest.image_size {list(size)}"
        if settings.backbone != "precomputed":
            with error_context(params), error_context(where):
                encoder_file.check_size(model, size)

        if settings.epochs:
            fitted = fit_or_reuse(folder, settings, architecture, model, ingest=data / "ingest")
            curve = fitted["curve"]
            config |= fitted["config"]
            config["losses"] = {name: curve[-1][name] for name in LOSSES}
        else:
            encoder_file.save_encoder(folder.new, architecture, model.state_dict())

        config["sources"] = architecture.get("sources", [])
        config["parameters"] = sum(parameter.numel() for parameter in model.parameters())
        store.write_json(folder.new / "config.json", config)
        path = folder.new / "curve.csv"
        table = pd.DataFrame(curve, columns=["epoch", *LOSSES])
        table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")

    frames = sum(config.get("frames_per_drive", {}).values())
    action = f"fitted on {frames} frames" if curve else "weights used as they are"
    parameters = f"{config['parameters']:,} parameters"
    print(f"encoder: {settings.backbone}, {parameters}, {action}", flush=True)
    for source in config["sources"]:
        print(f"encoder: {source}", flush=True)
    return out


def fit_or_reuse(
    folder: StageFolder,
    settings: Encoder,
    architecture: Architecture,
    model: torch.nn.Module,
    ingest: Path,
) -> Summary:
    """Fit the encoder on the training drives, or take the fit of an earlier run.

    Returns the summary of :func:`pipeline.encoder.fit.fit_drives`.
    """
    # The initial weights are written to a file, so that the cache key of the fit depends on them.
    encoder_file.save_encoder(folder.kept / "start", architecture, model.state_dict())
    start = folder.kept / "start" / encoder_file.FILE

    drives = store.drives_in(store.read_index(ingest, stage="ingest"), "train")
    files = [ingest / f"{drive}.h5" for drive in drives]
    work = partial(
        fit_drives,
        model=model,
        architecture=architecture,
        settings=settings,
        ingest=ingest,
        drives=drives,
    )
    job = Job("encoder", encoder_file.FILE, [start, *files], work)
    summaries = make_drives(folder, [job], settings, log_format="{frames} frames", workers=1)
    return summaries["encoder"]


if __name__ == "__main__":
    console.run(main)
