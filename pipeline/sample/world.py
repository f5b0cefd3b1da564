"""Cast rays at the sample: objects and traffic as triangles (Open3D's ray casting), the ground as
two planes.
"""

from typing import Any, NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.sample.plan import ASPHALT, BAY, GRASS, KERB_M, KERBSTONE, MARKING, PAVEMENT, Plan
from pipeline.sample.shapes import Mesh

_GROUND_CLASS = np.zeros(6, np.uint8)
_GROUND_CLASS[[GRASS, PAVEMENT, KERBSTONE]] = classes.TERRAIN, classes.SIDEWALK, classes.SIDEWALK
_GROUND_CLASS[[ASPHALT, MARKING, BAY]] = classes.ROAD
_SKY = len(_GROUND_CLASS)  # the surface after the kinds of ground
FAR_M = 500.0  # beyond it, the ground is sky
_SHADOW_M = 150.0  # longest shadow


class Hits(NamedTuple):
    """Per ray: distance [N] (inf: sky), cls uint8 [N], colour [3,N] albedo, normal [3,N] towards
    the viewer (sky: 0), ground int8 [N]: the plan's kind, -1 for objects and sky."""

    distance_m: np.ndarray
    cls: np.ndarray
    colour: np.ndarray
    normal: np.ndarray
    ground: np.ndarray


class World:
    """One drive's street; traffic is set frame by frame.

    Rays and points are float32 [6,N] (origin, unit direction) and [3,N]: numpy is several times
    faster on rows than on triples.
    """

    def __init__(self, plan: Plan, street: Mesh, ground_colours: np.ndarray) -> None:
        """`ground_colours` [6,3]: albedo of each kind of ground."""
        self.plan = plan
        self._street = _Layer(street)
        self._ground_colours = ground_colours.astype(np.float32)
        self.set_traffic([])

    def set_traffic(self, cars: list[Mesh]) -> None:
        """Replace the moving cars."""
        self._layers = [self._street, *(_Layer(car) for car in cars)]
        # Surface numbers: the kinds of ground, the sky, the triangles of each layer.
        sky, meshes = np.zeros((1, 3), np.float32), [layer.mesh for layer in self._layers]
        self._cls = np.concatenate(
            [_GROUND_CLASS, np.array([classes.SKY], np.uint8), *(mesh.cls for mesh in meshes)]
        )
        self._colour = np.concatenate(
            [self._ground_colours, sky, *(mesh.colour for mesh in meshes)]
        ).T.copy()

    def cast(self, rays: np.ndarray) -> Hits:
        """Return the first hits of `rays` [6,N]."""
        count, first = rays.shape[1], _SKY + 1
        distance, surface = np.full(count, np.inf, np.float32), np.full(count, _SKY)
        normal = np.zeros((3, count), np.float32)
        for layer in self._layers:
            candidates = layer.near(rays)
            t, triangle, facing = layer.cast(rays[:, candidates])
            nearer = t < distance[candidates]
            ray = candidates[nearer]
            distance[ray], surface[ray], normal[:, ray] = (
                t[nearer],
                triangle[nearer] + first,
                facing[:, nearer],
            )
            first += len(layer.mesh.cls)
        ground = self._cast_ground(rays, distance)
        met = ground >= 0
        surface = np.where(met, ground, surface)
        normal[:2, met], normal[2, met] = 0, 1
        return Hits(
            distance, self._cls.take(surface), self._colour.take(surface, axis=1), normal, ground
        )

    def lit(self, points: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Return bool [N]: `points` [3,N] are not in the shadow for the sun in direction `sun`
        [3].
        """
        rays = np.empty((6, points.shape[1]), np.float32)
        rays[:3], rays[3:] = points, sun[:, None]
        lit = np.ones(points.shape[1], bool)
        for layer in self._layers:
            lit[layer.blocks(rays)] = False
        return lit

    def _cast_ground(self, rays: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Lower `distance` in place where the ground is nearer; return its kind there, otherwise
        -1.
        """
        kind = np.full(rays.shape[1], -1, np.int8)
        down = np.flatnonzero(rays[5] < -1e-6)
        for level, on_road in ((KERB_M, False), (0.0, True)):
            t = (level - rays[2].take(down)) / rays[5].take(down)
            hit = (t < distance.take(down)) & (t < FAR_M)
            down, t = down[hit], t[hit]
            x, y = (rays[axis].take(down) + t * rays[3 + axis].take(down) for axis in (0, 1))
            there = self.plan.kind[self.plan.cells(x, y)]
            # A ray over road at kerb height continues down to the road.
            road = (there == ASPHALT) | (there == MARKING) | (there == BAY)
            stop = np.full(len(road), True) if on_road else ~road
            kind[down[stop]], distance[down[stop]] = there[stop], t[stop]
            down = down[~stop]
        return kind


class _Layer:
    """A mesh prepared for ray casting. Most rays miss the bounding sphere of a car."""

    def __init__(self, mesh: Mesh) -> None:
        import open3d as o3d

        self.mesh = mesh
        # One thread: Embree's parallel build is not guaranteed to be deterministic.
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(_tensor(mesh.vertices), _tensor(mesh.triangles))
        self._middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        self._radius = float(np.linalg.norm(mesh.vertices - self._middle, axis=1).max()) + 0.01

    def cast(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return per ray: distance (miss: inf), triangle, normal [3,N] towards the viewer."""
        answer = self._scene.cast_rays(_tensor(rays.T))
        distance = answer["t_hit"].numpy()
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        normal = np.ascontiguousarray(answer["primitive_normals"].numpy().T)
        normal *= np.where(dot(normal, rays[3:]) > 0, np.float32(-1), np.float32(1))
        return distance, triangle, normal

    def blocks(self, rays: np.ndarray) -> np.ndarray:
        """Return the indices of the rays that hit."""
        candidates = self.near(rays)
        return candidates[
            self._scene.test_occlusions(_tensor(rays[:, candidates].T), 0.02, _SHADOW_M).numpy()
        ]

    def near(self, rays: np.ndarray) -> np.ndarray:
        """Return the indices of the rays whose line intersects the mesh's bounding sphere."""
        to = self._middle[:, None] - rays[:3]
        ahead = dot(to, rays[3:])
        aside = dot(to, to) - ahead**2
        return np.flatnonzero((aside < self._radius**2) & (ahead > -self._radius))


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products [...] of vectors [3, ...]. Unlike BLAS's, the result does not depend on
    threads.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _tensor(array: np.ndarray) -> Any:
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array))
