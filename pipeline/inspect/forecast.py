"""How long a project's run takes and what it writes: its params.yaml at measured rates, an estimate."""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.base.params import load, load_entry, names
from pipeline.inspect import rates
from pipeline.inspect.rates import START_S, Network, Size
from pipeline.sections.clouds import Clouds
from pipeline.sections.encoder import Encoder
from pipeline.sections.graphs import Variant
from pipeline.sections.ingest import Ingest
from pipeline.sections.models import Model
from pipeline.sections.motion import Motion
from pipeline.sections.town import Town
from pipeline.sections.train import Train

_SCAN_POINTS = 120_000  # of KITTI's scans, where none is seen
_ONE_CORE = ("encoder", "train", "report", "check")  # the others spread over frames or drives


@dataclass(frozen=True)
class Forecast:
    """Stage, as DVC calls it, → seconds of one core, and bytes that it writes."""

    seconds: dict[str, float]
    bytes: dict[str, float]

    def hours(self, stages: Iterable[str], cores: int) -> float:
        """Return how long some stages take, one after the other."""
        chosen = [stage for stage in stages if stage in self.seconds]
        spread = {stage: 1 if stage.partition("@")[0] in _ONE_CORE else cores for stage in chosen}
        return sum(START_S + self.seconds[stage] / spread[stage] for stage in chosen) / 3600


def forecast(params: Path, kitti_frames: dict[str, int], scan_points: int) -> Forecast:
    """Forecast all stages of a project.

    Args:
        kitti_frames: drive → its frames, of those of data/raw that are known.
        scan_points: that a scan there has; 0: unknown.

    Raises InputError as :func:`pipeline.base.params.load` does.
    """
    ingest, town, clouds = load(Ingest, params), load(Town, params), load(Clouds, params)
    encoder, motion, train = load(Encoder, params), load(Motion, params), load(Train, params)
    sources, splits = ingest.sources(), ingest.drives.splits()
    of_drive = {
        drive: getattr(town.frames, splits[drive]) if source == "town" else kitti_frames.get(drive, 0)
        for drive, source in sources.items()
    }
    rays = town.scan_rays[0] * town.scan_rays[1]
    size = Size(
        town_frames=sum(frames for drive, frames in of_drive.items() if sources[drive] == "town"),
        kitti_frames=sum(frames for drive, frames in of_drive.items() if sources[drive] == "kitti"),
        train_frames=sum(of_drive[drive] for drive in ingest.drives.train),
        pixels=ingest.image_size[0] * ingest.image_size[1],
        town_scan_points=rays if ingest.lidar else 0,
        kitti_scan_points=(scan_points or _SCAN_POINTS) if ingest.lidar else 0,
    )
    models = {name: load_entry(Model, "models", name, params) for name in names("models", params)}
    variants = {model.input: load_entry(Variant, "graphs", model.input, params) for model in models.values()}
    fitted = min(encoder.frames, max(size.train_frames, 1)) * encoder.epochs
    seconds = {
        "check": 0.0,
        **rates.seconds_of_raw_stages(
            size, (encoder.backbone, fitted), {kind: kind in motion.kinds for kind in ("visual", "lidar")}
        ),
        "clouds": rates.seconds_of_clouds(size, clouds.max_points, 2 if ingest.lidar else 1),
        "pictures": len(splits) * 2.0,
        "report": 10.0,
    }
    written = {
        **rates.bytes_of_raw_stages(size),
        "clouds": size.frames * clouds.max_points * rates.PER_CLOUD_POINT_B * (2 if ingest.lidar else 1),
    }
    for name, variant in variants.items():
        seconds[f"graphs@{name}"] = rates.seconds_of_graphs(size, variant.points)
        per_point = size.frames * (variant.points or 0) * rates.PER_GRAPH_POINT_B
        written[f"graphs@{name}"] = per_point or rates.bytes_of_images(size)
    for name, model in models.items():
        network = _network(model, variants[model.input], train, ingest)
        seconds[f"train@{name}"] = rates.seconds_of_training(size, network)
        seconds[f"evaluate@{name}"] = (
            size.frames / max(size.train_frames, 1) * seconds[f"train@{name}"] / (3 * network.epochs * network.networks)
        )
    return Forecast(seconds, written)


def _network(model: Any, variant: Variant, train: Train, ingest: Ingest) -> Network:
    folds = 1 if model.fit_to == "train" else len(ingest.drives.test)
    return Network(
        variant.points, model.spatial, train.epochs, len(train.seeds) * folds, model.window, train.run_windows,
        model.equivariant,
    )  # fmt: skip


def free_bytes(folder: Path) -> int:
    """Return what the disk under `folder` has free."""
    return shutil.disk_usage(folder).free


def present_bytes(data: Path, stages: Iterable[str]) -> int:
    """Return what the outputs of some stages take now: writing them again needs no more than what they grow by."""
    from pipeline.inspect.reading import size_of

    folders = (data / stage.replace("@", "/") for stage in stages)
    return sum(size_of(folder) for folder in folders if folder.is_dir())
