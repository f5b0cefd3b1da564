"""Build objects from coloured triangles: boxes, houses, hedges, trees, posts, cars."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.sample.route import unit_vector

# Albedo of a surface, RGB [3] in 0..1.
Colour = np.ndarray | tuple[float, float, float]
# Metres along x, y and z.
Size = tuple[float, float, float]

# Albedo of lamp posts, RGB in 0..1.
_GREY = (0.42, 0.44, 0.45)
# Albedo of trunks.
_BARK = (0.30, 0.22, 0.15)
# Albedo of a car's windows.
_GLASS = (0.10, 0.13, 0.16)
# Albedo of wooden fences, before random shading.
_WOOD = np.array([0.42, 0.28, 0.16])
# Albedos of leaves, before random shading.
_LEAVES = np.array([(0.16, 0.30, 0.08), (0.22, 0.34, 0.10), (0.12, 0.24, 0.10), (0.30, 0.34, 0.12)])
# Albedo of tyres.
_TYRE = (0.04, 0.04, 0.04)
# Albedo of a car's rear lights.
_REAR_LIGHT = (0.45, 0.03, 0.03)
# Albedo of a car's headlights.
_HEADLIGHT = (0.9, 0.9, 0.8)
# Albedos of cars, of which a car has one.
_PAINTS = np.array(
    [
        (0.75, 0.75, 0.77),
        (0.9, 0.9, 0.9),
        (0.1, 0.1, 0.12),
        (0.5, 0.06, 0.06),
        (0.08, 0.14, 0.4),
        (0.3, 0.32, 0.34),
        (0.1, 0.3, 0.2),
        (0.65, 0.5, 0.15),
    ]
)

# Corners of a box with sides of 1, whose foot is centred on the origin.
_BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
# Triangles of a box, two for each side, as numbers of its corners.
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2],
        [4, 6, 7], [4, 7, 5],
        [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6],
        [0, 2, 6], [0, 6, 4],
        [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


class Mesh(NamedTuple):
    """Triangles, each with a colour and a class."""

    vertices: np.ndarray  # float32 [V,3]
    triangles: np.ndarray  # uint32 [T,3]
    colour: np.ndarray  # float32 [T,3] in 0..1
    cls: np.ndarray  # uint8 [T] trainId

    def moved_to(
        self, xy: np.ndarray | tuple[float, float], heading_rad: float = 0.0, z: float = 0.0
    ) -> "Mesh":
        """Return the mesh after a rotation about z and a translation."""
        c = np.cos(heading_rad)
        s = np.sin(heading_rad)
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        vertices = self.vertices @ R.T + [*xy, z]
        return self._replace(vertices=vertices.astype(np.float32))


def colour_mesh(vertices: np.ndarray, triangles: np.ndarray, colour: Colour, cls: int) -> Mesh:
    """Return a mesh of a single class. `colour` is that of all triangles, or [T,3]."""
    count = len(triangles)
    return Mesh(
        vertices.astype(np.float32),
        triangles.astype(np.uint32),
        np.broadcast_to(np.asarray(colour, np.float32), (count, 3)),
        np.full(count, cls, np.uint8),
    )


def merge_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into a single mesh."""
    triangles = []
    first_vertex = 0
    for part in meshes:
        triangles.append(part.triangles + np.uint32(first_vertex))
        first_vertex += len(part.vertices)
    return Mesh(
        np.concatenate([part.vertices for part in meshes]),
        np.concatenate(triangles),
        np.concatenate([part.colour for part in meshes]),
        np.concatenate([part.cls for part in meshes]),
    )


def draw_colour(rng: np.random.Generator, colours: np.ndarray) -> np.ndarray:
    """Draw one of `colours` [K,3]."""
    return colours[rng.integers(len(colours))]


def build_box(size: Size, colour: Colour, cls: int, taper: float = 1.0) -> Mesh:
    """Build a box of `size` (x, y, z) on the origin. Its top is `taper` times its length."""
    corners = _BOX_CORNERS * size
    top = _BOX_CORNERS[:, 2] > 0
    corners[top, 0] *= taper
    return colour_mesh(corners, _BOX_FACES, colour, cls)


def build_house(size: Size, colour: Colour, roof: Colour, roof_m: float) -> Mesh:
    """Build a house with a gable roof of height `roof_m`; 0 is a flat roof.

    `size` is its length along the street, its depth, and the height of its walls.
    """
    length, depth, height = size
    walls = build_box(size, colour, classes.BUILDING)
    if roof_m == 0:
        return walls

    # The roof overhangs the walls; its ridge is along the street.
    x = length / 2 + 0.3
    y = depth / 2 + 0.4
    ridge = height + roof_m
    corners = np.array(
        [
            [-x, -y, height],
            [x, -y, height],
            [x, y, height],
            [-x, y, height],
            [-x, 0, ridge],
            [x, 0, ridge],
        ]
    )
    slope_faces = np.array([[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5]])
    gable_faces = np.array([[1, 2, 5], [3, 0, 4]])
    slopes = colour_mesh(corners, slope_faces, roof, classes.BUILDING)
    gables = colour_mesh(corners, gable_faces, colour, classes.BUILDING)
    return merge_meshes([walls, slopes, gables])


def build_wall(outline: np.ndarray, height_m: float | np.ndarray, colour: Colour, cls: int) -> Mesh:
    """Build vertical faces along a closed outline [N,2]. `height_m` is a number, or [N]."""
    n = len(outline)
    bottom = np.column_stack([outline, np.zeros(n)])
    top = np.column_stack([outline, np.full(n, height_m)])
    i = np.arange(n)
    j = (i + 1) % n  # the next point
    lower = np.stack([i, j, j + n], axis=1)
    upper = np.stack([i, j + n, i + n], axis=1)
    return colour_mesh(np.concatenate([bottom, top]), np.concatenate([lower, upper]), colour, cls)


def build_cylinder(radius_m: float, height_m: float, colour: Colour, cls: int) -> Mesh:
    """Build an upright tube on the origin, open at both ends."""
    circle = unit_vector(np.arange(8) * 2 * np.pi / 8)
    return build_wall(radius_m * circle, height_m, colour, cls)


@cache
def _unit_sphere() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of the unit sphere."""
    import open3d as o3d

    ball = o3d.geometry.TriangleMesh.create_sphere(1.0, resolution=7)
    return np.asarray(ball.vertices), np.asarray(ball.triangles)


def _draw_leaves(rng: np.random.Generator) -> np.ndarray:
    """Draw the colour of leaves."""
    return draw_colour(rng, _LEAVES) * rng.uniform(0.8, 1.2)


def build_hedge(rng: np.random.Generator) -> Mesh:
    """Build a hedge or a wooden fence of 4.5 m, along x on the origin."""
    if rng.random() < 0.5:
        height_m = rng.uniform(0.9, 1.5)
        return build_box((4.5, 0.7, height_m), _draw_leaves(rng), classes.VEGETATION)
    colour = _WOOD * rng.uniform(0.8, 1.2)
    return build_box((4.5, 0.1, rng.uniform(1.0, 1.4)), colour, classes.FENCE)


def build_tree(rng: np.random.Generator, height_m: float) -> Mesh:
    """Build a trunk under a lumpy crown."""
    leaves = _draw_leaves(rng)
    trunk_m = height_m * rng.uniform(0.3, 0.42)
    trunk = build_cylinder(0.035 * height_m, trunk_m * 1.2, _BARK, classes.VEGETATION)

    vertices, faces = _unit_sphere()
    lumpy = vertices * (1 + rng.uniform(-0.17, 0.17, (len(vertices), 1)))
    wide_m = height_m * rng.uniform(0.22, 0.32)
    high_m = (height_m - trunk_m) / 2 * 1.1
    vertices = lumpy * [wide_m, wide_m, high_m] + [0, 0, trunk_m + high_m * 0.85]
    shade = rng.uniform(0.75, 1.2, (len(faces), 1))
    crown = colour_mesh(vertices, faces, leaves * shade, classes.VEGETATION)
    return merge_meshes([crown, trunk])


def build_lamp_post(height_m: float) -> Mesh:
    """Build a post with an arm towards +x, where the road is."""
    post = build_cylinder(0.19, height_m, _GREY, classes.POLE)
    arm = build_box((1.6, 0.22, 0.18), _GREY, classes.POLE)
    return merge_meshes([post, arm.moved_to((0.7, 0.0), z=height_m - 0.18)])


def build_car(rng: np.random.Generator) -> Mesh:
    """Build a car with a length of 3.9 to 4.7 m, which heads along +x, over the origin."""
    paint = draw_colour(rng, _PAINTS)
    length = rng.uniform(3.9, 4.7)
    width = rng.uniform(1.7, 1.85)
    roof = rng.uniform(1.42, 1.65) - 0.1
    waist = 0.9
    cabin_x = -0.06 * length
    return merge_meshes(
        [
            _car_part((length, width, waist - 0.22), paint, x=0.0, z=0.22),
            _car_part(
                (0.62 * length, width - 0.12, roof - waist), _GLASS, x=cabin_x, z=waist, taper=0.68
            ),
            _car_part((0.44 * length, width - 0.14, 0.1), paint, x=cabin_x, z=roof),
            _car_part((0.06, width - 0.1, 0.16), _REAR_LIGHT, x=-length / 2, z=0.66),
            _car_part((0.06, width - 0.1, 0.14), _HEADLIGHT, x=length / 2, z=0.6),
            _car_part((0.62, width + 0.02, 0.6), _TYRE, x=-0.3 * length, z=0.0),
            _car_part((0.62, width + 0.02, 0.6), _TYRE, x=0.31 * length, z=0.0),
        ]
    )


def _car_part(size: Size, colour: Colour, x: float, z: float, taper: float = 1.0) -> Mesh:
    """Build a box whose middle is at `x` along the car and whose foot is at `z`."""
    return build_box(size, colour, classes.CAR, taper).moved_to((x, 0.0), z=z)
