"""What bounds the roads and the world: kerbs, barriers, woods on the horizon."""

import numpy as np

from pipeline.camera import classes
from pipeline.town import shapes
from pipeline.town.plan import CELL_M, KERB_M, Plan
from pipeline.town.route import Route, unit
from pipeline.town.shapes import Mesh

BARRIER_M = (2.0, 3.5)  # from the junction's edge to the barrier of a closed arm


def kerbs(plan: Plan) -> Mesh:
    """Vertical faces along the roads' outlines."""
    parts = []
    for outline in plan.kerbs():
        n = len(outline)
        vertices = np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in (0.0, KERB_M)])
        i, j = np.arange(n), (np.arange(n) + 1) % n
        faces = np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)])
        parts.append(shapes.mesh(vertices, faces, (0.5, 0.5, 0.49), classes.SIDEWALK))
    return shapes.merge(parts)


def horizon(plan: Plan, rng: np.random.Generator) -> Mesh:
    """A ring of woods around everything."""
    size = np.array(plan.kind.shape[::-1]) * CELL_M
    middle, radius, n = plan.origin + size / 2, np.linalg.norm(size) / 2 + 25, 160
    angle = np.arange(n) * 2 * np.pi / n
    ring = middle + radius * unit(angle)
    heights = 9 + 5 * rng.random(n) + 4 * np.sin(angle * 3 + rng.uniform(0, 6.28))
    vertices = np.concatenate([np.column_stack([ring, np.zeros(n)]), np.column_stack([ring, heights])])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)])
    return shapes.mesh(vertices, faces, (0.13, 0.20, 0.10), classes.VEGETATION)


def barriers(route: Route, rng: np.random.Generator) -> list[Mesh]:
    """Red and white boards across the roads that are closed, just beyond the junction."""
    parts = []
    for arm in route.arms:
        if not arm.closed:
            continue
        middle = arm.xy + (route.lane_m + 0.25 + rng.uniform(*BARRIER_M)) * unit(arm.heading_rad)
        boards = np.arange(-arm.half_m + 0.35, arm.half_m, 0.7)
        for i, across in enumerate(boards):
            colour = (0.75, 0.08, 0.06) if i % 2 else (0.9, 0.9, 0.88)
            xy = middle + across * unit(arm.heading_rad + np.pi / 2)
            parts.append(shapes.box((0.12, 0.7, 1.15), colour, classes.FENCE).placed(xy, arm.heading_rad))
    return parts
