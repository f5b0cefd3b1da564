"""Rays in a small world with known hits."""

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.sample import shapes
from pipeline.sample.light import draw_ground_colours
from pipeline.sample.plan import ASPHALT, GRASS, KERB_M, Plan
from pipeline.sample.world import World

DOWN = [0.0, 0.0, -1.0]


@pytest.fixture(scope="module")
def world() -> World:
    """Return a world with road at x < 0, grass elsewhere and a wall of 2 m at x = 10."""
    kind = np.full((400, 400), GRASS, np.uint8)
    kind[:, :200] = ASPHALT
    plan = Plan(kind, (kind == GRASS).astype(np.float32), np.array([-20.0, -20.0]), {}, np.zeros(0, bool))
    wall = shapes.box((1.0, 6.0, 2.0), (0.5, 0.4, 0.3), classes.BUILDING).placed((10.5, 0.0), z=KERB_M)
    return World(plan, wall, draw_ground_colours(np.random.default_rng(0)))


def rays(*pairs: tuple[list[float], list[float]]) -> np.ndarray:
    array = np.array([origin + direction for origin, direction in pairs], np.float32).T
    array[3:] /= np.linalg.norm(array[3:], axis=0)
    return array


def test_hits_of_rays(world: World) -> None:
    hits = world.cast(
        rays(
            ([-5.0, 0, 3], DOWN),  # road, at the bottom of the kerb
            ([5.0, 0, 3], DOWN),  # grass, at its top
            ([0.5, 0, 1], [1, 0, 0]),  # the wall
            ([0.5, 0, 2.5], [1, 0, 0]),  # over it
        )
    )
    np.testing.assert_array_equal(hits.cls, [classes.ROAD, classes.TERRAIN, classes.BUILDING, classes.SKY])
    np.testing.assert_allclose(hits.distance_m, [3, 3 - KERB_M, 9.5, np.inf], rtol=1e-5)
    np.testing.assert_allclose(hits.normal.T, [[0, 0, 1], [0, 0, 1], [-1, 0, 0], [0, 0, 0]], atol=1e-6)


def test_traffic_hides_what_is_behind_it_and_leaves_again(world: World) -> None:
    ray = rays(([-8.0, 0, 0.7], [1, 0, 0]), ([-8.0, 3, 0.7], [0, 1, 0.01]))
    car = shapes.car(np.random.default_rng(0))
    world.set_traffic([car.placed((-2.0, 0.0)), car.placed((-2.0, 300.0))])
    hits = world.cast(ray)
    np.testing.assert_array_equal(hits.cls, [classes.CAR, classes.SKY])
    assert 3 < hits.distance_m[0] < 5
    under_the_car = np.array([[-2.0, 0, 0.02]], np.float32).T
    assert not world.lit(under_the_car, np.array([0.0, 0, 1]))[0]
    world.set_traffic([])
    assert world.cast(ray).cls[0] == classes.BUILDING
    assert world.lit(under_the_car, np.array([0.0, 0, 1]))[0]
