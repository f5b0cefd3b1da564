"""Find faults of a model's entry: look for its inputs, and run its quantity and its network."""

from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.hashes import list_files
from pipeline.check.check_quantity import check_quantity
from pipeline.check.contract import check_network
from pipeline.check.settings import Params
from pipeline.graphs.settings import Variant
from pipeline.train import runs
from pipeline.train.entry import Entry
from pipeline.train.quantity import load_quantity

# Folder of the networks.
STEERING = "models/steering"


def check_network_folders() -> None:
    """Raise InputError if the folders of networks have files whose changes DVC would not notice.

    DVC watches the module of each network, and the folder of weights.
    """
    for part in ("spatial", "temporal"):
        folder = ROOT / STEERING / part
        for path in list_files(folder):
            name = path.relative_to(folder)
            if path.parent == folder and path.suffix == ".py":
                continue
            network, _, _ = name.parts[0].partition(".")
            watched = f"{STEERING}/weights/{name}"
            if not (folder / f"{network}.py").is_file():
                watched = (
                    f"{STEERING}/weights/NETWORK/{name}, where NETWORK is the one that reads it"
                )
            problem = "DVC would not notice its changes"
            raise InputError(problem, path.relative_to(ROOT), f"Move it to {watched}")


def check_model(entry: Entry, settings: Params) -> None:
    """Check a model's inputs, its quantity and its network. Raises InputError."""
    if entry.input not in settings.graphs:
        options = closest(entry.input, [*settings.graphs])
        raise InputError(f"unknown variant {entry.input!r}: {options}", "input")
    variant = settings.graphs[entry.input]

    quantity = load_quantity(entry.predict)(settings.labels.model_dump(), entry.horizon)

    # If labels are measured motion, this motion must not be an input, too. If they lie ahead of the
    # last input frame it may be, as it is earlier than the label.
    has_motion = entry.motion != "none"
    if has_motion and settings.labels.are_measured and not entry.predicts_ahead:
        problem = (
            f"motion: {entry.motion} with labels.source: {settings.labels.source} at horizon: 0 "
            "makes the label an input"
        )
        fix = "Set motion: none, a horizon above 0, or labels.source: ingest, or remove the model"
        raise InputError(problem, fix=fix)

    if variant.source == "clouds/lidar" and not settings.ingest.lidar:
        raise InputError(f"input = {entry.input!r} needs scans, but ingest.lidar is false")
    _check_columns(entry, variant, settings)
    if variant.points and variant.points > settings.clouds.max_points:
        problem = f"graphs.{entry.input}.points = {variant.points} is above clouds.max_points"
        fix = "Raise clouds.max_points, for which all clouds are made again, or lower the points"
        raise InputError(f"{problem} = {settings.clouds.max_points}", fix=fix)
    if entry.network.reads_edges and not variant.k and variant.kind == "graph":
        problem = f"spatial = {entry.spatial!r} reads edges, but graphs.{entry.input} has none"
        raise InputError(problem, fix=f"Set graphs.{entry.input}.k, for instance to 6")
    if entry.window == 1 and entry.override(settings.train).batch_spans == 1:
        problem = "window: 1 and batch_spans: 1 make steps of a single frame, which has no variance"
        raise InputError(problem, fix="Set batch_spans to 2 or more")
    runs.check_splits(settings.ingest.drives.splits())
    with error_context(f"predict: {entry.predict}"):
        check_quantity(quantity, settings.labels)
    outputs = len(quantity.columns)
    image_size = settings.ingest.image_size
    net = entry.build(variant.kind, image_size, outputs)
    check_network(net, entry, variant, image_size, outputs=outputs)


def _check_columns(entry: Entry, variant: Variant, settings: Params) -> None:
    """Check that a variant has the columns that the network reads, and the clouds its columns."""
    for name in entry.network.reads_columns:
        if name not in variant.columns:
            problem = f"spatial = {entry.spatial!r} reads column {name!r}, but graphs.{entry.input}"
            raise InputError(f"{problem} lacks it", fix=f"Add it to graphs.{entry.input}.columns")
    for name in variant.columns:
        if name not in settings.clouds.columns:
            problem = f"graphs.{entry.input} has column {name!r}, but the clouds lack it"
            raise InputError(problem, fix="Add it to clouds.columns")
