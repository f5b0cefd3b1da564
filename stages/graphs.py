"""Make one graph variant, all that a network eats: data/graphs/<variant>/<drive>.h5."""

from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base import pool as drives
from pipeline.base.params import load_entry
from pipeline.graphs import cloud, graph, neighbourhoods
from pipeline.sections.graphs import Variant


def main(
    name: Annotated[str, typer.Argument(metavar="VARIANT", help="an entry of graphs: in the params file")],
    clouds: Path = Path("data/clouds"),
    out: Annotated[Path, typer.Option(help="default data/graphs/VARIANT")] = Path("data/graphs"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
    ingest: Annotated[Path, typer.Option(help="read by variants with cloud: none")] = Path("data/ingest"),
) -> None:
    """Sample each cloud to the variant's number of points and find who neighbours whom; or copy the images."""
    variant = load_entry(Variant, "graphs", name, params)
    source, stage = (ingest, "ingest") if variant.kind == "image" else (clouds / variant.cloud, "clouds")
    splits = store.read_index(source, stage=stage)
    summaries = drives.run_over_drives(
        partial(_images if variant.kind == "image" else _points, source=source, variant=variant),
        list(splits),
        module="stages.graphs",
        out=out / name,
        resume=out.parent / ".resume" / f"{out.name}-{name}",
        inputs=lambda drive: [source / f"{drive}.h5"],
        settings=variant.model_dump(),
        workers=workers,
        describe=lambda summary: ", ".join(f"{number} {what}" for what, number in summary.items()),
    )
    store.write_index(out / name, splits)
    before, after = (sum(summary.get(key, 0) for summary in summaries.values()) for key in ("kNN edges", "kept"))
    if before:
        print(f"{name}: {after / before:.0%} of {before} kNN edges kept")
    empty = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if empty:
        print(f"{name}: no frames in {', '.join(empty)} (nothing to make them from)")


def _points(drive: str, path: Path, source: Path, variant: Variant) -> drives.Summary:
    with (
        store.DriveReader(source / f"{drive}.h5", stage="clouds") as points,
        store.DriveWriter(path, stage="graphs", drive=drive, params={"graphs": variant.model_dump()}) as file,
    ):
        file.put("frame", points.frame)
        file.put("time_s", points.time_s, unit="s")
        neighbourhood = (_Knn if variant.kind == "graph" else _Sets)(file, variant)
        file.append("xyz", np.empty((0, 3), np.float32), unit="m")
        file.append("cls", np.empty(0, np.uint8), unit="trainId")
        ptr = points["ptr"]
        nodes = []
        for row, number in enumerate(points.frame):
            rng = cloud.frame_rng(variant.seed, drive, int(number))
            xyz, cls = (points.rows(name, ptr[row], ptr[row + 1]) for name in ("xyz", "cls"))
            inside = cloud.cropped(xyz, variant.crop_m)
            chosen = inside[cloud.sample(len(inside), variant.points, rng)]
            xyz, cls = xyz[chosen], cls[chosen]
            file.append("xyz", xyz)
            file.append("cls", cls)
            neighbourhood.append(xyz, cls, rng)
            nodes.append(len(xyz))
        file.put("ptr", store.pointers(nodes), unit="row")
        return {"frames": len(nodes), "points": sum(nodes)} | neighbourhood.finish()


class _Knn:
    """The kNN graph of each frame: degree, indices, and how many edges there were."""

    def __init__(self, file: store.DriveWriter, variant: Variant) -> None:
        self._file, self._variant = file, variant
        self._made: list[tuple[int, int, int]] = []  # entries, kNN edges, kept edges of each frame
        file.append("degree", np.empty(0, np.uint8), unit="neighbours")
        file.append("indices", np.empty(0, graph.index_dtype(variant.points)), unit="node")

    def append(self, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> None:
        made = graph.build(xyz, cls, self._variant.k, self._variant.keep_inter_class, rng)
        self._file.append("degree", made.degree)
        self._file.append("indices", made.indices)
        self._made.append((len(made.indices), made.edges_knn, made.edges_kept))

    def finish(self) -> drives.Summary:
        entries, edges_knn, edges_kept = np.array(self._made, np.int64).reshape(-1, 3).T
        self._file.put("indices_ptr", store.pointers(entries), unit="row")
        self._file.put("edges_knn", edges_knn.astype(np.int32), unit="directed edges")
        self._file.put("edges_kept", edges_kept.astype(np.int32), unit="directed edges")
        return {"kNN edges": int(edges_knn.sum()), "kept": int(edges_kept.sum())}


class _Sets:
    """PointNet++'s samplings and groupings of each frame: centres_1, neighbours_1, centres_2, …"""

    def __init__(self, file: store.DriveWriter, variant: Variant) -> None:
        self._file = file
        self._sizes = variant.levels
        self._dtype = graph.index_dtype(variant.points)
        self._counts: list[list[int]] = [[] for _ in self._sizes]
        for number, (_, _, neighbours) in enumerate(self._sizes, start=1):
            file.append(f"centres_{number}", np.empty(0, self._dtype), unit="point or centre of the level before")
            file.append(f"neighbours_{number}", np.empty((0, neighbours), self._dtype), unit="as the centres")

    def append(self, xyz: np.ndarray, cls: np.ndarray, rng: np.random.Generator) -> None:
        for number, level in enumerate(neighbourhoods.levels(xyz, self._sizes, rng), start=1):
            self._file.append(f"centres_{number}", level.centres.astype(self._dtype))
            self._file.append(f"neighbours_{number}", level.neighbours.astype(self._dtype))
            self._counts[number - 1].append(len(level.centres))

    def finish(self) -> drives.Summary:
        for number, counts in enumerate(self._counts, start=1):
            self._file.put(f"centres_{number}_ptr", store.pointers(counts), unit="row")
        return {"centres": sum(sum(counts) for counts in self._counts)}


def _images(drive: str, path: Path, source: Path, variant: Variant) -> drives.Summary:
    with (
        store.DriveReader(source / f"{drive}.h5", stage="ingest") as raw,
        store.DriveWriter(path, stage="graphs", drive=drive, params={"graphs": variant.model_dump()}) as file,
    ):
        rows = np.flatnonzero(raw["has_image"])
        file.put("frame", raw.frame[rows])
        file.put("time_s", raw.time_s[rows], unit="s")
        file.append("image", np.empty((0, *raw.shape("image")[1:]), np.uint8), unit="RGB")
        for row in rows:
            file.append("image", raw.row("image", int(row))[None])
    return {"frames": len(rows)}


if __name__ == "__main__":
    console.run(main)
