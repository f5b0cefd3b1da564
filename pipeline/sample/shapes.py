"""Build objects from coloured triangles: boxes, houses, cylinders, trees, cars."""

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.sample.route import unit

Colour = tuple[float, float, float]


class Mesh(NamedTuple):
    """vertices float32 [V,3], triangles uint32 [T,3], colour float32 [T,3] in 0..1, cls uint8 [T]
    (trainId).
    """

    vertices: np.ndarray
    triangles: np.ndarray
    colour: np.ndarray
    cls: np.ndarray

    def placed(
        self, xy: np.ndarray | tuple[float, float], heading_rad: float = 0.0, z: float = 0.0
    ) -> "Mesh":
        """Return the mesh, rotated about z, then translated."""
        c, s = np.cos(heading_rad), np.sin(heading_rad)
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        return Mesh(
            (self.vertices @ R.T + [xy[0], xy[1], z]).astype(np.float32),
            self.triangles,
            self.colour,
            self.cls,
        )


def mesh(
    vertices: np.ndarray, triangles: np.ndarray, colour: Colour | np.ndarray, cls: int
) -> Mesh:
    """Return a mesh of one class, with one colour or a colour per triangle."""
    colours = np.broadcast_to(np.asarray(colour, np.float32), (len(triangles), 3)).copy()
    return Mesh(
        vertices.astype(np.float32),
        triangles.astype(np.uint32),
        colours,
        np.full(len(colours), cls, np.uint8),
    )


def merge(parts: Iterable[Mesh]) -> Mesh:
    """Join meshes into one."""
    vertices, triangles, colour, cls = zip(*parts, strict=True)
    starts = np.cumsum([0, *map(len, vertices[:-1])])
    renumbered = [part + np.uint32(start) for part, start in zip(triangles, starts, strict=True)]
    return Mesh(*map(np.concatenate, (vertices, renumbered, colour, cls)))


_BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
    [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def box(size: tuple[float, float, float], colour: Colour, cls: int, taper: float = 1.0) -> Mesh:
    """Build a box of `size` (x, y, z) on the origin; its top is `taper` times as long along x."""
    corners = _BOX_CORNERS * size
    corners[:, 0] *= np.where(_BOX_CORNERS[:, 2] > 0, taper, 1.0)
    return mesh(corners, _BOX_FACES, colour, cls)


def house(size: tuple[float, float, float], colour: Colour, roof: Colour, roof_m: float) -> Mesh:
    """Build a house of `size` (x along the street, y deep, z high) with a gable roof of height
    `roof_m` (0: flat).
    """
    length, depth, height = size
    walls = box(size, colour, classes.BUILDING)
    if roof_m == 0:
        return walls
    x, y, top = length / 2 + 0.3, depth / 2 + 0.4, height + roof_m
    ridge = np.array(
        [
            [-x, -y, height],
            [x, -y, height],
            [x, y, height],
            [-x, y, height],
            [-x, 0, top],
            [x, 0, top],
        ]
    )
    slopes = mesh(
        ridge, np.array([[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5]]), roof, classes.BUILDING
    )
    gables = mesh(ridge, np.array([[1, 2, 5], [3, 0, 4]]), colour, classes.BUILDING)
    return merge([walls, slopes, gables])


def wall(outline: np.ndarray, height_m: float | np.ndarray, colour: Colour, cls: int) -> Mesh:
    """Build vertical faces along a closed outline [N,2], from z = 0 to `height_m`, one number or
    [N].
    """
    n = len(outline)
    vertices = np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in (0.0, height_m)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)])
    return mesh(vertices, faces, colour, cls)


def cylinder(radius_m: float, height_m: float, colour: Colour, cls: int) -> Mesh:
    """Build an upright tube on the origin, open at both ends."""
    return wall(radius_m * unit(np.arange(8) * 2 * np.pi / 8), height_m, colour, cls)


@cache
def _sphere() -> tuple[np.ndarray, np.ndarray]:
    import open3d as o3d

    ball = o3d.geometry.TriangleMesh.create_sphere(1.0, resolution=7)
    return np.asarray(ball.vertices), np.asarray(ball.triangles)


def tree(rng: np.random.Generator, height_m: float, leaves: Colour) -> Mesh:
    """Build a trunk under a lumpy crown."""
    trunk_m = height_m * rng.uniform(0.3, 0.42)
    vertices, faces = _sphere()
    vertices = vertices * (1 + rng.uniform(-0.17, 0.17, (len(vertices), 1)))
    wide, high = height_m * rng.uniform(0.22, 0.32), (height_m - trunk_m) / 2 * 1.1
    crown = vertices * [wide, wide, high] + [0, 0, trunk_m + high * 0.85]
    shade = rng.uniform(0.75, 1.2, (len(faces), 1))
    trunk = cylinder(0.035 * height_m, trunk_m * 1.2, (0.30, 0.22, 0.15), classes.VEGETATION)
    return merge([mesh(crown, faces, np.asarray(leaves) * shade, classes.VEGETATION), trunk])


def lamp_post(height_m: float) -> Mesh:
    """Build a post with an arm over the road (towards +x)."""
    grey = (0.42, 0.44, 0.45)
    arm = box((1.6, 0.22, 0.18), grey, classes.POLE).placed((0.7, 0.0), z=height_m - 0.18)
    return merge([cylinder(0.19, height_m, grey, classes.POLE), arm])


def car(rng: np.random.Generator) -> Mesh:
    """Build a car of 3.9 to 4.7 m, heading along +x, centred over the origin."""
    palette = [
        (0.75, 0.75, 0.77),
        (0.9, 0.9, 0.9),
        (0.1, 0.1, 0.12),
        (0.5, 0.06, 0.06),
        (0.08, 0.14, 0.4),
        (0.3, 0.32, 0.34),
        (0.1, 0.3, 0.2),
        (0.65, 0.5, 0.15),
    ]
    paint = palette[rng.integers(len(palette))]
    length, width, waist, height = (
        rng.uniform(3.9, 4.7),
        rng.uniform(1.7, 1.85),
        0.9,
        rng.uniform(1.42, 1.65),
    )
    glass, roof = (0.10, 0.13, 0.16), height - 0.1
    cabin_x = -0.06 * length
    parts = [
        box((length, width, waist - 0.22), paint, classes.CAR).placed((0, 0.0), z=0.22),
        box((0.62 * length, width - 0.12, roof - waist), glass, classes.CAR, 0.68).placed(
            (cabin_x, 0.0), z=waist
        ),
        box((0.44 * length, width - 0.14, 0.1), paint, classes.CAR).placed((cabin_x, 0.0), z=roof),
        box((0.06, width - 0.1, 0.16), (0.45, 0.03, 0.03), classes.CAR).placed(
            (-length / 2, 0.0), z=0.66
        ),
        box((0.06, width - 0.1, 0.14), (0.9, 0.9, 0.8), classes.CAR).placed(
            (length / 2, 0.0), z=0.6
        ),
    ]
    for x in (-0.3, 0.31):
        parts.append(
            box((0.62, width + 0.02, 0.6), (0.04, 0.04, 0.04), classes.CAR).placed(
                (x * length, 0.0)
            )
        )
    return merge(parts)
