"""Stage graphs: build a variant of the networks' input, and write data/graphs/<variant>/."""

from functools import partial
from pathlib import Path

from pipeline.jobs import console
from pipeline.jobs.console import EntryName
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import file_jobs, make_drives

from pipeline.base import store
from pipeline.base.params import entry_name, load_entry
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.graphs.settings import Variant


def main(
    name: EntryName = None, data: Path = Path("data"), params: Path = Path("params.yaml")
) -> Path:
    """Draw points of each cloud and connect them to a graph, or copy images. Return the folder."""
    name = entry_name(name)
    variant = load_entry(Variant, "graphs", name, params)
    source = data / variant.source
    out = data / "graphs" / name
    stage, _, _ = variant.source.partition("/")
    splits = store.read_index(source, stage=stage)

    jobs = file_jobs(splits, {"source": source}, partial(graphs_drive, variant=variant))
    log_format = "{frames} frames"
    if variant.kind != "image":
        log_format += ", {points} points{edges}"
    with stage_folder(f"graphs@{name}", out, splits, params=params) as folder:
        make_drives(folder, jobs, variant, log_format=log_format)
    return out


if __name__ == "__main__":
    console.run(main)
