"""What a ray meets: street furniture and traffic as triangles (Open3D's ray casting), the ground as two planes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline import classes
from pipeline.town.plan import ASPHALT, BAY, GRASS, KERB_M, KERBSTONE, MARKING, PAVEMENT, Plan
from pipeline.town.shapes import Mesh, merge

_GROUND_CLASS = np.zeros(6, np.uint8)
_GROUND_CLASS[[GRASS, PAVEMENT, KERBSTONE]] = classes.TERRAIN, classes.SIDEWALK, classes.SIDEWALK
_GROUND_CLASS[[ASPHALT, MARKING, BAY]] = classes.ROAD
FAR_M = 500.0


@dataclass(frozen=True)
class Hits:
    """Per ray: distance [N] (inf: sky), cls uint8 [N], colour [N,3] albedo, normal [N,3] towards the viewer,
    ground int8 [N]: the plan's kind, -1 for what is no ground."""

    distance_m: np.ndarray
    cls: np.ndarray
    colour: np.ndarray
    normal: np.ndarray
    ground: np.ndarray


class World:
    """One drive's street; traffic is set frame by frame."""

    def __init__(self, plan: Plan, street: Mesh, ground_colours: np.ndarray) -> None:
        """`ground_colours` [6,3]: albedo of each kind of the plan."""
        self.plan = plan
        self._ground_colours = ground_colours.astype(np.float32)
        self._layers = [(_scene(street), street)]

    def set_traffic(self, cars: list[Mesh]) -> None:
        self._layers = self._layers[:1]
        if cars:
            traffic = merge(cars)
            self._layers.append((_scene(traffic), traffic))

    def cast(self, rays: np.ndarray) -> Hits:
        """Return what `rays` float32 [N,6] (origin, unit direction) meet first."""
        n = len(rays)
        distance = np.full(n, np.inf, np.float32)
        cls = np.full(n, classes.SKY, np.uint8)
        colour, normal = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
        for scene, mesh in self._layers:
            answer = scene.cast_rays(_tensor(rays))
            t = answer["t_hit"].numpy()
            hit = np.flatnonzero(t < distance)
            triangle = answer["primitive_ids"].numpy()[hit]
            distance[hit] = t[hit]
            cls[hit], colour[hit] = mesh.cls[triangle], mesh.colour[triangle]
            facing = answer["primitive_normals"].numpy()[hit]
            away = np.einsum("ij,ij->i", facing, rays[hit, 3:]) > 0
            normal[hit] = np.where(away[:, None], -facing, facing)
        ground = self._cast_ground(rays, distance)
        met = np.flatnonzero(ground >= 0)
        cls[met], colour[met] = _GROUND_CLASS[ground[met]], self._ground_colours[ground[met]]
        normal[met] = 0, 0, 1
        return Hits(distance, cls, colour, normal, ground)

    def lit(self, points: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Return bool [N]: nothing stands between `points` [N,3] and the sun in direction `sun` [3]."""
        rays = np.empty((len(points), 6), np.float32)
        rays[:, :3], rays[:, 3:] = points, sun
        blocked = [scene.test_occlusions(_tensor(rays), 0.02, 150.0).numpy() for scene, _ in self._layers]
        return ~np.any(blocked, axis=0)

    def _cast_ground(self, rays: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Lower `distance` in place where the ground is nearer; return the kind of ground there, else -1."""
        kind = np.full(len(rays), -1, np.int8)
        down = np.flatnonzero(rays[:, 5] < -1e-6)
        for level, on_road in ((KERB_M, False), (0.0, True)):
            rays_down = rays[down]
            t = (level - rays_down[:, 2]) / rays_down[:, 5]
            near = (t < distance[down]) & (t < FAR_M)
            down, t, rays_down = down[near], t[near], rays_down[near]
            there = self.plan.kind[self.plan.cells(rays_down[:, :2] + t[:, None] * rays_down[:, 3:5])]
            # A ray that finds road at kerb height goes on down to the road.
            road = (there == ASPHALT) | (there == MARKING) | (there == BAY)
            stop = np.full(len(road), True) if on_road else ~road
            kind[down[stop]], distance[down[stop]] = there[stop], t[stop]
            down = down[~stop]
        return kind


def _scene(mesh: Mesh) -> Any:
    import open3d as o3d

    # One building thread: Embree's parallel build is not promised to give the same tree twice.
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(mesh.vertices), o3d.core.Tensor(mesh.triangles))
    return scene


def _tensor(rays: np.ndarray) -> Any:
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(rays, np.float32))
