"""Stage graphs: build one variant of the networks' input, data/graphs/<variant>/<drive>.h5."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load_entry
from pipeline.base.runner import Job, Summary, make_drives
from pipeline.graphs import cloud
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.settings.graphs import Variant


def main(
    name: Annotated[str, typer.Argument(metavar="VARIANT", help="an entry of graphs: in the params file")],
    data: Annotated[Path, typer.Option(help="contains the variant's source and motion")] = Path("data"),
    out: Annotated[Path, typer.Option(help="VARIANT is written below it")] = Path("data/graphs"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Sample each cloud to the variant's number of points and compute neighbours; or copy the images.

    Returns the variant's folder.
    """
    variant = load_entry(Variant, "graphs", name, params)
    source, stage = data / variant.source, variant.source.split("/")[0]
    splits = store.read_index(source, stage=stage)
    jobs = []
    for drive in splits:
        inputs = source / f"{drive}.h5", data / "motion" / f"{drive}.h5"
        work = partial(graphs_drive, source=inputs[0], motion=inputs[1], variant=variant)
        jobs.append(Job(drive, f"{drive}.h5", inputs, work))
    with stage_folder(f"graphs@{name}", out / name) as folder:
        summaries = make_drives(folder, jobs, variant, _describe, workers)
        if variant.kind != "image":
            crop = variant.crop_m and f"Widen crop_m = {list(variant.crop_m)}: left, near, right, far in metres"
            with error_context(f"{params}: graphs.{name}", crop or f"Repeat: dvc repro --force --single-item {stage}"):
                cloud.check_not_empty(summaries, splits)
        store.write_index(folder.new, splits)
    before, after = (sum(summary.get(key, 0) for summary in summaries.values()) for key in ("edges_knn", "edges_kept"))
    without = [drive for drive, summary in summaries.items() if not summary["frames"]]
    share = f", {after / before:.0%} of {before} kNN edges kept" if before else ""
    print(f"{name}: {len(splits)} drives{share}" + (f"; no frames in {', '.join(without)}" if without else ""))
    return out / name


def _describe(summary: Summary) -> str:
    return ", ".join(f"{number} {name}" for name, number in summary.items())


if __name__ == "__main__":
    console.run(main)
