"""What a ray meets: street furniture and traffic as triangles (Open3D's ray casting), the ground as two planes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.camera import classes
from pipeline.town.plan import ASPHALT, BAY, GRASS, KERB_M, KERBSTONE, MARKING, PAVEMENT, Plan
from pipeline.town.shapes import Mesh

_GROUND_CLASS = np.zeros(6, np.uint8)
_GROUND_CLASS[[GRASS, PAVEMENT, KERBSTONE]] = classes.TERRAIN, classes.SIDEWALK, classes.SIDEWALK
_GROUND_CLASS[[ASPHALT, MARKING, BAY]] = classes.ROAD
FAR_M = 500.0  # beyond it, the ground is sky
_SHADOW_M = 150.0  # longest shadow


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
        self._layers = [_Layer(street)]

    def set_traffic(self, cars: list[Mesh]) -> None:
        self._layers = [self._layers[0], *(_Layer(car, bounded=True) for car in cars)]

    def cast(self, rays: np.ndarray) -> Hits:
        """Return what `rays` float32 [N,6] (origin, unit direction) meet first."""
        street, *traffic = self._layers
        distance, cls, colour, normal = street.cast(rays)
        for layer in traffic:
            near = layer.near(rays)
            t, *found = layer.cast(rays[near])
            nearer = t < distance[near]
            ray = near[nearer]
            distance[ray], cls[ray], colour[ray], normal[ray] = t[nearer], *(values[nearer] for values in found)
        ground = self._cast_ground(rays, distance)
        met = np.flatnonzero(ground >= 0)
        cls[met], colour[met] = _GROUND_CLASS[ground[met]], self._ground_colours[ground[met]]
        normal[met] = 0, 0, 1
        return Hits(distance, cls, colour, normal, ground)

    def lit(self, points: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Return bool [N]: nothing stands between `points` [N,3] and the sun in direction `sun` [3]."""
        rays = np.empty((len(points), 6), np.float32)
        rays[:, :3], rays[:, 3:] = points, sun
        lit = np.ones(len(points), bool)
        for layer in self._layers:
            lit[layer.blocks(rays)] = False
        return lit

    def _cast_ground(self, rays: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Lower `distance` in place where the ground is nearer; return the kind of ground there, else -1."""
        kind = np.full(len(rays), -1, np.int8)
        down = np.flatnonzero(rays[:, 5] < -1e-6)
        for level, on_road in ((KERB_M, False), (0.0, True)):
            t = (level - rays[down, 2]) / rays[down, 5]
            near = (t < distance[down]) & (t < FAR_M)
            down, t = down[near], t[near]
            x, y = (rays[down, axis] + t * rays[down, 3 + axis] for axis in (0, 1))
            there = self.plan.kind[self.plan.cells(np.stack([x, y], axis=-1))]
            # A ray that finds road at kerb height goes on down to the road.
            road = (there == ASPHALT) | (there == MARKING) | (there == BAY)
            stop = np.full(len(road), True) if on_road else ~road
            kind[down[stop]], distance[down[stop]] = there[stop], t[stop]
            down = down[~stop]
        return kind


class _Layer:
    """A mesh to cast rays at."""

    def __init__(self, mesh: Mesh, bounded: bool = False) -> None:
        """`bounded`: the mesh is small, most rays miss it."""
        import open3d as o3d

        # One building thread: Embree's parallel build is not promised to give the same tree twice.
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(_tensor(mesh.vertices), _tensor(mesh.triangles))
        # Of each triangle, and at the end of what a ray meets that meets none.
        self._cls = np.append(mesh.cls, np.uint8(classes.SKY))
        self._colour = np.concatenate([mesh.colour, np.zeros((1, 3), np.float32)])
        self._bounded = bounded
        self._middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        self._radius = float(np.linalg.norm(mesh.vertices - self._middle, axis=1).max()) + 0.01

    def cast(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return per ray: distance (inf: nothing), class, colour, normal towards the viewer (nothing: 0)."""
        answer = self._scene.cast_rays(_tensor(rays))
        triangle = np.minimum(answer["primitive_ids"].numpy(), len(self._cls) - 1)
        normal = answer["primitive_normals"].numpy()
        normal *= np.where(dot(normal, rays[:, 3:]) > 0, np.float32(-1), np.float32(1))[:, None]
        return answer["t_hit"].numpy(), self._cls[triangle], self._colour.take(triangle, axis=0), normal

    def blocks(self, rays: np.ndarray) -> np.ndarray:
        """Return the indices of the rays that hit."""
        near = self.near(rays) if self._bounded else None
        shadow = self._scene.test_occlusions(_tensor(rays if near is None else rays[near]), 0.02, _SHADOW_M).numpy()
        return np.flatnonzero(shadow) if near is None else near[shadow]

    def near(self, rays: np.ndarray) -> np.ndarray:
        """Return the indices of the rays whose line meets the mesh's sphere."""
        to = self._middle - rays[:, :3]
        ahead = dot(to, rays[:, 3:])
        aside = dot(to, to) - ahead**2
        return np.flatnonzero((aside < self._radius**2) & (ahead > -self._radius))


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products [...] of vectors [..., 3]. Unlike BLAS's, the result does not depend on threads."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _tensor(array: np.ndarray) -> Any:
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array))
