"""Find faults of a model's entry: build its network, and look for its inputs."""

from pipeline.base.errors import InputError, closest
from pipeline.check.settings import Params
from pipeline.labels import source
from pipeline.train import runs
from pipeline.train.entry import Entry


def check_model(entry: Entry, settings: Params) -> None:
    """Build a model's network and check that its inputs are available. Raises InputError."""
    if entry.input not in settings.graphs:
        raise InputError(
            f"unknown variant {entry.input!r}: {closest(entry.input, [*settings.graphs])}", "input"
        )
    variant = settings.graphs[entry.input]
    outputs = len(settings.labels.ahead_m) - 1 if entry.predict == "path" else 1
    if outputs < 1:
        raise InputError(
            "predict: path needs labels.ahead_m (got [])",
            fix="Set it to edges, for instance [0, 10]",
        )
    measured = entry.motion != "none" and source.load(settings.labels.source).MEASURED
    if entry.predict == "angle" and measured and not entry.horizon:
        raise InputError(
            f"motion: {entry.motion} with labels.source: {entry.motion} at horizon: 0 makes the "
            "label an input",
            fix=(
                "Set motion: none, a horizon above 0, or another labels.source, or remove the model"
            ),
        )
    if variant.source == "clouds/lidar" and not settings.ingest.lidar:
        raise InputError(f"input = {entry.input!r} needs scans, but ingest.lidar is false")
    runs.check(settings.ingest.drives.splits(), entry.scene)
    entry.build(variant.kind, len(variant.levels), settings.ingest.image_size, outputs)
