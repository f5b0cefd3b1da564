"""Find faults of a model's entry: build its network, and look for its inputs."""

from pipeline.base.errors import InputError, closest
from pipeline.check.settings import Params
from pipeline.labels import source
from pipeline.train import runs
from pipeline.train.entry import Entry


def check_model(entry: Entry, settings: Params) -> None:
    """Build a model's network and check that its inputs are available. Raises InputError."""
    if entry.input not in settings.graphs:
        options = closest(entry.input, [*settings.graphs])
        raise InputError(f"unknown variant {entry.input!r}: {options}", "input")
    variant = settings.graphs[entry.input]

    # A path has one output for each range between two edges.
    outputs = 1
    if entry.predict == "path":
        outputs = len(settings.labels.ahead_m) - 1
    if outputs < 1:
        fix = "Set it to edges, for instance [0, 10]"
        raise InputError("predict: path needs labels.ahead_m (got [])", fix=fix)

    # If labels are measured motion, this motion must not be an input, too. With a horizon above 0
    # it may be, as it is earlier than the label.
    has_motion = entry.motion != "none"
    labels_are_measured = source.load_source(settings.labels.source).MEASURED
    if entry.predict == "angle" and has_motion and labels_are_measured and not entry.horizon:
        problem = (
            f"motion: {entry.motion} with labels.source: {settings.labels.source} at horizon: 0 "
            "makes the label an input"
        )
        fix = "Set motion: none, a horizon above 0, or another labels.source, or remove the model"
        raise InputError(problem, fix=fix)

    if variant.source == "clouds/lidar" and not settings.ingest.lidar:
        raise InputError(f"input = {entry.input!r} needs scans, but ingest.lidar is false")
    # A network that sees the scene of another drive needs a second drive in each split.
    runs.check_splits(settings.ingest.drives.splits(), entry.scene)
    entry.build(variant.kind, len(variant.levels), settings.ingest.image_size, outputs)
