"""Cast rays at a street of the sample.

Objects are triangles, which Open3D casts rays at. The ground is two planes: the road, and a plane
at the height of the kerb. Rays are float32 [6,N], with origin and unit direction; points are
[3,N]. numpy is several times as fast on these rows as on triples [N,3].
"""

from typing import Any, NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.sample.plan import ASPHALT, BAY, GRASS, KERB_M, KERBSTONE, MARKING, PAVEMENT, Plan
from pipeline.sample.shapes import Mesh

# Distance in metres up to which the ground is rendered; beyond it is the sky.
FAR_M = 500.0
# Length in metres of the longest shadow.
_SHADOW_M = 150.0

# Number of a surface: 0 to 5 are the kinds of ground, 6 is the sky, and then come all triangles.
_SKY = 6
# Least distance in metres of a triangle that shades a point. The point's own surface is nearer.
_NEAREST_SHADE_M = 0.02
# Margin in metres of bounding spheres, for rounding.
_MARGIN_M = 0.01
# Class of each kind of ground and of the sky.
_CLASSES = np.zeros(_SKY + 1, np.uint8)
_CLASSES[GRASS] = classes.TERRAIN
_CLASSES[[PAVEMENT, KERBSTONE]] = classes.SIDEWALK
_CLASSES[[ASPHALT, MARKING, BAY]] = classes.ROAD
_CLASSES[_SKY] = classes.SKY


class Hits(NamedTuple):
    """The first surface that each of N rays hits."""

    distance_m: np.ndarray  # [N], infinite for the sky
    cls: np.ndarray  # uint8 [N]
    colour: np.ndarray  # [3,N], albedo
    normal: np.ndarray  # [3,N], on the viewer's side of the surface; 0 for the sky
    ground: np.ndarray  # int8 [N], kind of ground in the plan; -1 for objects and sky


class World:
    """The street of a drive, with moving cars that are set for each frame."""

    def __init__(self, plan: Plan, street: Mesh, ground_colours: np.ndarray) -> None:
        """Store the street; `ground_colours` [6,3] are the albedo of each kind of ground."""
        self.plan = plan
        self._street = _Layer(street)
        self._colours = np.zeros((_SKY + 1, 3), np.float32)
        self._colours[:_SKY] = ground_colours
        self.set_traffic([])

    def set_traffic(self, cars: list[Mesh]) -> None:
        """Replace the moving cars."""
        self._layers = [self._street, *(_Layer(car) for car in cars)]

        # Surfaces are numbered in this order: the kinds of ground, the sky, and the triangles of
        # each layer.
        meshes = [layer.mesh for layer in self._layers]
        self._surface_cls = np.concatenate([_CLASSES, *(mesh.cls for mesh in meshes)])
        colours = np.concatenate([self._colours, *(mesh.colour for mesh in meshes)])
        self._surface_colour = colours.T.copy()

    def cast_rays(self, rays: np.ndarray) -> Hits:
        """Return the first hits of `rays` [6,N]."""
        count = rays.shape[1]
        distance_m = np.full(count, np.inf, np.float32)
        surface = np.full(count, _SKY)
        normal = np.zeros((3, count), np.float32)

        # A layer replaces the hits of earlier layers if it is nearer.
        first_surface = _SKY + 1
        for layer in self._layers:
            candidates = layer.find_candidates(rays)
            layer_distance_m, triangle, layer_normal = layer.cast_rays(rays[:, candidates])
            nearer = layer_distance_m < distance_m[candidates]
            ray = candidates[nearer]
            distance_m[ray] = layer_distance_m[nearer]
            surface[ray] = first_surface + triangle[nearer]
            normal[:, ray] = layer_normal[:, nearer]
            first_surface += len(layer.mesh.cls)

        # The ground replaces hits behind it, too. Its normal points upwards.
        ground = self._cast_ground(rays, distance_m)
        on_ground = ground >= 0
        surface = np.where(on_ground, ground, surface)
        normal[:, on_ground] = [[0], [0], [1]]
        cls = self._surface_cls.take(surface)
        colour = self._surface_colour.take(surface, axis=1)
        return Hits(distance_m, cls, colour, normal, ground)

    def find_lit(self, points: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Return whether `points` [3,N] see the sun in direction `sun` [3], bool [N]."""
        rays = np.empty((6, points.shape[1]), np.float32)
        rays[:3] = points
        rays[3:] = sun[:, None]
        lit = np.ones(points.shape[1], bool)
        for layer in self._layers:
            lit[layer.find_blocked(rays)] = False
        return lit

    def _cast_ground(self, rays: np.ndarray, distance_m: np.ndarray) -> np.ndarray:
        """Return the kind of ground that each ray hits first, int8 [N], or -1 if it hits none.

        `distance_m` has the distances to objects. Where the ground is nearer, its distance replaces
        them in place.
        """
        kind = np.full(rays.shape[1], -1, np.int8)
        x, y, z, dx, dy, dz = rays
        ray = np.flatnonzero(dz < -1e-6)
        for level_m in (KERB_M, 0.0):
            # Keep the rays that reach this level before an object.
            t = (level_m - z.take(ray)) / dz.take(ray)
            hit = (t < distance_m.take(ray)) & (t < FAR_M)
            ray = ray[hit]
            t = t[hit]
            level_x = x.take(ray) + t * dx.take(ray)
            level_y = y.take(ray) + t * dy.take(ray)
            level_kind = self.plan.kind[self.plan.cells_at(level_x, level_y)]

            # A ray that is above a road at the height of the kerb continues down to the road.
            ends = np.full(len(ray), True)
            if level_m > 0:
                ends = _CLASSES[level_kind] != classes.ROAD
            kind[ray[ends]] = level_kind[ends]
            distance_m[ray[ends]] = t[ends]
            ray = ray[~ends]
        return kind


class _Layer:
    """A mesh prepared for ray casting.

    Only rays that meet its bounding sphere are cast, since most rays miss that of a car.
    """

    def __init__(self, mesh: Mesh) -> None:
        import open3d as o3d

        self.mesh = mesh
        # A single thread builds the scene, since Embree's parallel build may differ between runs.
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(_to_tensor(mesh.vertices), _to_tensor(mesh.triangles))
        self._middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        from_middle_m = np.linalg.norm(mesh.vertices - self._middle, axis=1)
        self._radius_m = float(from_middle_m.max()) + _MARGIN_M

    def cast_rays(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return for each ray the distance, the triangle and the normal [3,N] of its first hit.

        The distance is infinite if the ray hits nothing. Normals are on the viewer's side.
        """
        hits = self._scene.cast_rays(_to_tensor(rays.T))
        distance_m = hits["t_hit"].numpy()
        triangle = hits["primitive_ids"].numpy().astype(np.int64)
        normal = np.ascontiguousarray(hits["primitive_normals"].numpy().T)
        normal *= np.where(dot_product(normal, rays[3:]) > 0, np.float32(-1), np.float32(1))
        return distance_m, triangle, normal

    def find_blocked(self, rays: np.ndarray) -> np.ndarray:
        """Return the indices of the rays that hit the mesh."""
        candidates = self.find_candidates(rays)
        tensor = _to_tensor(rays[:, candidates].T)
        hit = self._scene.test_occlusions(tensor, _NEAREST_SHADE_M, _SHADOW_M).numpy()
        return candidates[hit]

    def find_candidates(self, rays: np.ndarray) -> np.ndarray:
        """Return the indices of the rays that meet the mesh's bounding sphere."""
        to_middle = self._middle[:, None] - rays[:3]
        ahead_m = dot_product(to_middle, rays[3:])
        aside_m2 = dot_product(to_middle, to_middle) - ahead_m**2
        return np.flatnonzero((aside_m2 < self._radius_m**2) & (ahead_m > -self._radius_m))


def dot_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the scalar products [...] of vectors [3, ...].

    Unlike a product by BLAS, the result does not depend on the number of threads.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _to_tensor(array: np.ndarray) -> Any:
    """Return an Open3D tensor; Open3D has no types."""
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array))
