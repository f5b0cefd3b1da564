"""Rows of the chain on the sample that ``make demo`` left in data/: what a second worker brings, and the demo."""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from benchmarks.rows.row import Row, compare
from pipeline.base import store
from pipeline.kitti import ingest_file
from pipeline.motion import kinds
from pipeline.sections.preset import merged
from stages import clouds, graphs, perception, train

LONG = 400  # frames of the drive that two workers share
ENLARGED = 2  # times, its images: to the paper's 192 x 640. The sample's own are seen before a worker has begun
POINTS = 10_000  # of its graphs
NETWORKS = 2  # that are trained side by side


def blocks(data: Path) -> Row:
    """Perception, clouds and graphs of one long drive: images of 192 x 640 pixels, clouds as for real drives."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        params = _params(folder, "kitti", POINTS)
        drive = next(iter(store.read_index(data / "ingest", stage="ingest")))
        repeated(data / f"ingest/{drive}.h5", folder / f"ingest/{drive}.h5", drive, LONG)
        store.write_index(folder / "ingest", {drive: "train"})
        kinds.write(folder / "motion", [])

        def chain(workers: int) -> None:
            with _environment(STEER_WORKERS=str(workers)):  # one worker may take no more than a core
                _chain(folder, data / "encoder", params)

        text = f"perception, clouds, graphs of one drive of {LONG} frames: 2 workers / 1"
        return compare(_s(partial(chain, 2)), _s(partial(chain, 1)), "s", text)


def _params(folder: Path, preset: str, points: int) -> Path:
    """Write a preset's settings of the chain to `folder`, with no model to train."""
    content = merged(preset) | {"models": {}}
    content["graphs"]["semantic"] |= {"source": "clouds/pseudo", "points": points}
    path = folder / "params.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def _chain(folder: Path, encoder: Path, params: Path) -> None:
    perception.main(folder / "ingest", encoder, folder / "perception", params)
    clouds.main(folder / "ingest", folder / "perception", folder / "clouds", params)
    graphs.main("semantic", folder, folder / "graphs", params)


def cluster(data: Path) -> Row:
    """Perception, clouds and graphs of some drives of the sample, by a Dask cluster of this machine."""
    import distributed

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        params = _params(folder, "table2", 1000)
        splits = store.read_index(data / "ingest", stage="ingest")
        kept = {drive: split for drive, split in splits.items() if drive in list(splits)[::15]}
        (folder / "ingest").mkdir()
        for drive in kept:
            (folder / f"ingest/{drive}.h5").symlink_to((data / f"ingest/{drive}.h5").resolve())
        store.write_index(folder / "ingest", kept)
        kinds.write(folder / "motion", [])

        def chain(address: str) -> None:
            with _environment(STEER_SCHEDULER=address):
                _chain(folder, data / "encoder", params)

        with ExitStack() as clusters:
            one, two = (
                clusters.enter_context(
                    distributed.LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
                ).scheduler_address
                for workers in (1, 2)
            )
            text = f"perception, clouds, graphs of {len(kept)} drives of the sample: 2 Dask workers / 1"
            return compare(_s(partial(chain, two)), _s(partial(chain, one)), "s", text)


def side_by_side(data: Path) -> Row:
    """Training networks of the sample's size, a thread each, as ``make table2`` does with seeds."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        content = merged("table2")
        content["models"] = {name: content["models"][name] for name in ("sa-gnn-ncp",)}
        content["train"] |= {"epochs": 2, "seeds": list(range(NETWORKS))}
        params = folder / "params.yaml"
        params.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        # A third of the training drives: as much as five turns leave time for.
        splits = store.read_index(data / "graphs/semantic", stage="graphs")
        of_split = {split: [drive for drive in splits if splits[drive] == split] for split in ("train", "val", "test")}
        kept = [*of_split["train"][::3], *of_split["val"][:1], *of_split["test"][:1]]
        (folder / "graphs/semantic").mkdir(parents=True)
        for drive in kept:
            (folder / f"graphs/semantic/{drive}.h5").symlink_to((data / f"graphs/semantic/{drive}.h5").resolve())
        store.write_index(folder / "graphs/semantic", {drive: splits[drive] for drive in kept})

        def fit(workers: int) -> None:
            with _environment(STEER_WORKERS=str(workers)):
                train.main("sa-gnn-ncp", folder / "graphs", data / "labels", folder / "train", params)
            shutil.rmtree(folder / "train")

        text = f"{NETWORKS} networks on {len(of_split['train'][::3])} drives of the sample: side by side / in turn"
        return compare(_s(partial(fit, 2)), _s(partial(fit, 1)), "s", text)


def demo(code: Path) -> Row:
    """The whole chain on the embedded sample, set-up left out, with an empty cache; once, as it takes minutes."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name in ("pipeline", "models", "stages"):
            shutil.copytree(code / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("dvc.yaml", "params.yaml", ".dvcignore"):
            shutil.copy(code / name, folder / name)
        (folder / "data").mkdir()
        shutil.copy(code / "data/.gitignore", folder / "data")
        _run(["dvc", "init", "--quiet", "--no-scm"], folder)
        start = time.perf_counter()
        _run(["dvc", "repro", "check", "pictures", "report"], folder)
        seconds = time.perf_counter() - start
        metrics = store.read_json(folder / "data/report/metrics.json", stage="report")
        nmse = metrics["sa-gnn-ncp.nmse"]
    return Row(seconds, None, "s", None, f"make demo after set-up, once; sa-gnn-ncp's nmse {nmse:.3f}")


def repeated(source: Path, out: Path, drive: str, count: int) -> None:
    """Write an ingest file of `count` frames: those of another, over and over, ENLARGED."""
    with (
        store.DriveReader(source, stage="ingest") as raw,
        store.DriveWriter(out, stage="ingest", drive=drive, params=raw.params) as file,
    ):
        file.attrs |= {key: value for key, value in raw.attrs.items() if key not in file.attrs}
        row = np.arange(count) % len(raw.frame)
        number = np.arange(count)
        ingest_file.put_motion(file, number, number * 0.1, raw["oxts"][row])
        ingest_file.put_camera(file, np.diag([ENLARGED, ENLARGED, 1.0]) @ raw["K"], raw["T_cam_velo"])
        for name in ingest_file.PIXELS:
            images = raw[name].repeat(ENLARGED, axis=1).repeat(ENLARGED, axis=2)
            ingest_file.put_pixels(file, name, count, images.shape[1:3], ((n, images[row[n]]) for n in range(count)))
        scans = [raw.rows("lidar", *ends) for ends in pairwise(raw["lidar_ptr"])]
        ingest_file.put_scans(file, count, ((n, scans[row[n]]) for n in range(count)))


def _s(work: Callable[[], None]) -> Callable[[], float]:
    def timed() -> float:
        start = time.perf_counter()
        work()
        return time.perf_counter() - start

    return timed


@contextmanager
def _environment(**variables: str) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _run(command: list[str], folder: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(folder)}
    subprocess.run(command, cwd=folder, check=True, env=environment, stdout=subprocess.DEVNULL)
