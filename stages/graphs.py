"""Stage graphs: build one variant of the networks' input, data/graphs/<variant>/<drive>.h5."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load_entry
from pipeline.base.runner import file_jobs, make_drives
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.graphs.settings import Variant


def main(
    name: Annotated[
        str, typer.Argument(metavar="VARIANT", help="an entry of graphs: in the params file")
    ],
    data: Path = Path("data"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Draw the variant's number of points of each cloud and compute neighbours, or copy images.
    Returns the folder.
    """
    variant = load_entry(Variant, "graphs", name, params)
    source, out = data / variant.source, data / "graphs" / name
    splits = store.read_index(source, stage=variant.source.split("/")[0])
    jobs = file_jobs(
        splits,
        {"source": source, "motion": data / "motion"},
        partial(graphs_drive, variant=variant),
    )
    text = "{frames} frames" if variant.kind == "image" else "{frames} frames, {points} points"
    with stage_folder(f"graphs@{name}", out, splits, params=params) as folder:
        make_drives(folder, jobs, variant, text)
    return out


if __name__ == "__main__":
    console.run(main)
