"""Clouds, graphs and sets of a stream of frames: what the stages clouds and graphs write for the spatial network."""

from collections import deque
from collections.abc import Generator, Iterable, Iterator

import numpy as np

from pipeline.camera.images import to_metres
from pipeline.graphs import accumulate, cloud, graph, neighbourhoods
from pipeline.live.moment import Moment
from pipeline.live.settings import Settings
from pipeline.live.view import View


class Inputs:
    """What makes a network's input of what was perceived. Random draws depend on drive and frame alone."""

    def __init__(self, settings: Settings, view: View) -> None:
        self._settings, self._variant, self._view = settings, settings.graphs, view
        self._K = view.K_at(settings.ingest.image_size)

    def given(self, moments: Iterable[Moment]) -> Generator[Moment]:
        """Add what the spatial network takes."""
        if self._variant.kind == "image":
            for moment in moments:
                moment.arrays = {"image": moment.small[None]}
                yield moment
            return
        for moment, whole in self._spanning(moments) if self._variant.accumulate else self._clouds(moments):
            moment.arrays = self._points(moment, whole)
            yield moment

    def _clouds(self, moments: Iterable[Moment]) -> Iterator[tuple[Moment, cloud.Cloud]]:
        """Yield each frame with its cloud as stage clouds stores it; a frame without the scan that it takes is none."""
        clouds = self._settings.clouds
        for moment in moments:
            if self._variant.source == "clouds/pseudo":
                made = cloud.pseudo_cloud(to_metres(moment.depth), moment.cls, self._K, clouds.max_depth_m)
            elif moment.scan is None:
                continue
            else:
                assert self._view.T_cam_velo is not None
                made = cloud.lidar_cloud(moment.scan, self._view.T_cam_velo, self._K, moment.cls)
            rng = cloud.frame_rng(clouds.seed, self._view.name, moment.number)
            yield moment, cloud.stored(made, clouds.max_points, rng)

    def _spanning(self, moments: Iterable[Moment]) -> Iterator[tuple[Moment, cloud.Cloud]]:
        """Yield each frame with the cloud of several frames."""
        spanning = self._variant.accumulate
        assert spanning
        waiting: deque[tuple[Moment, cloud.Cloud]] = deque()
        T_before: dict[int, np.ndarray] = {}

        def numbers() -> Iterator[int]:
            for moment, whole in self._clouds(moments):
                T_before.clear()
                if moment.T_before is not None:
                    T_before[moment.number] = moment.T_before
                waiting.append((moment, whole))
                yield moment.number

        def wholes() -> Iterator[cloud.Cloud]:
            while waiting:
                yield waiting[-1][1]

        for whole in accumulate.accumulated(numbers(), wholes(), T_before, spanning.frames):
            yield waiting.popleft()[0], whole

    def _points(self, moment: Moment, whole: cloud.Cloud) -> dict[str, np.ndarray]:
        """Return a cloud as stage graphs samples and connects it, in the arrays of pipeline.train.frames."""
        variant = self._variant
        assert variant.points
        rng = cloud.frame_rng(variant.seed, self._view.name, moment.number)
        chosen = cloud.chosen_points(whole, variant.crop_m, variant.points, rng)
        xyz, cls = cloud.ordered(chosen) if variant.accumulate else chosen
        arrays = {"xyz": xyz, "cls": cls, "ptr": np.array([0, len(xyz)])}
        if variant.kind == "graph":
            assert variant.k
            made = graph.build(xyz, cls, variant.k, variant.keep_inter_class, rng)
            return arrays | {"degree": made.degree, "indices": made.indices.astype(np.int32)}
        for number, level in enumerate(neighbourhoods.levels(xyz, variant.levels, rng), start=1):
            arrays |= {f"centres_{number}": level.centres, f"neighbours_{number}": level.neighbours}
            arrays[f"centres_{number}_ptr"] = np.array([0, len(level.centres)])
        return arrays
