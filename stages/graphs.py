"""Make one graph variant, all that a network eats: data/graphs/<variant>/<drive>.h5."""

from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline import cloud, console, drives, graph, store
from pipeline.params import load_entry
from pipeline.sections.graphs import Variant


def main(
    name: Annotated[str, typer.Argument(metavar="VARIANT", help="an entry of graphs: in the params file")],
    clouds: Path = Path("data/clouds"),
    out: Annotated[Path, typer.Option(help="default data/graphs/VARIANT")] = Path("data/graphs"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> None:
    """Sample each cloud to the variant's number of points, connect k nearest neighbours and prune between classes."""
    variant = load_entry(Variant, "graphs", name, params)
    source = clouds / variant.cloud
    splits = store.read_index(source, stage="clouds")
    summaries = drives.run_over_drives(
        partial(_graphs, source=source, variant=variant),
        list(splits),
        module="stages.graphs",
        out=out / name,
        resume=out.parent / ".resume" / f"{out.name}-{name}",
        inputs=lambda drive: [source / f"{drive}.h5"],
        settings=variant.model_dump(),
        workers=workers,
        describe=lambda summary: "{frames} frames, {edges_knn} kNN edges, {edges_kept} kept".format(**summary),
    )
    store.write_index(out / name, splits)
    before, after = (sum(summary[key] for summary in summaries.values()) for key in ("edges_knn", "edges_kept"))
    if before:
        print(f"{name}: {after / before:.0%} of {before} kNN edges kept")


def _graphs(drive: str, path: Path, source: Path, variant: Variant) -> drives.Summary:
    nodes, entries, edges_knn, edges_kept = [], [], [], []
    with (
        store.DriveReader(source / f"{drive}.h5", stage="clouds") as points,
        store.DriveWriter(path, stage="graphs", drive=drive, params=variant.model_dump()) as file,
    ):
        file.put("frame", points.frame)
        file.put("time_s", points.time_s, unit="s")
        file.append("xyz", np.empty((0, 3), np.float32), unit="m")
        file.append("cls", np.empty(0, np.uint8), unit="trainId")
        file.append("degree", np.empty(0, np.uint8), unit="neighbours")
        file.append("indices", np.empty(0, graph.index_dtype(variant.points)), unit="node")
        ptr = points["ptr"]
        for row, number in enumerate(points.frame):
            rng = cloud.frame_rng(variant.seed, drive, int(number))
            chosen = cloud.sample(ptr[row + 1] - ptr[row], variant.points, rng)
            xyz = points.rows("xyz", ptr[row], ptr[row + 1])[chosen]
            cls = points.rows("cls", ptr[row], ptr[row + 1])[chosen]
            made = graph.build(xyz, cls, variant.k, variant.keep_inter_class, rng)
            for key, value in {"xyz": xyz, "cls": cls, "degree": made.degree, "indices": made.indices}.items():
                file.append(key, value)
            nodes.append(len(xyz))
            entries.append(len(made.indices))
            edges_knn.append(made.edges_knn)
            edges_kept.append(made.edges_kept)
        file.put("ptr", store.pointers(nodes), unit="row")
        file.put("indices_ptr", store.pointers(entries), unit="row")
        file.put("edges_knn", np.array(edges_knn, np.int32), unit="directed edges")
        file.put("edges_kept", np.array(edges_kept, np.int32), unit="directed edges")
    return {"frames": len(nodes), "edges_knn": sum(edges_knn), "edges_kept": sum(edges_kept)}


if __name__ == "__main__":
    console.run(main)
