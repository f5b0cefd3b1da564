import numpy as np
import pytest

from pipeline.graphs import cloud, neighbourhoods


@pytest.fixture
def xyz() -> np.ndarray:
    """A street's width of points as clouds store them, some of them twice."""
    rng = np.random.default_rng(0)
    points = cloud.quantise(rng.uniform([-10, -1, 0], [10, 2, 40], (240, 3)))
    return points[np.sort(rng.integers(0, 240, 300))]


def squared(a: np.ndarray, b: np.ndarray) -> float:
    """In integers of 1/1024 m, so that nothing is rounded."""
    return sum((round(float(p) * 1024) - round(float(q) * 1024)) ** 2 for p, q in zip(a, b, strict=True)) / 1024**2


def reference_fps(xyz: np.ndarray, count: int) -> list[int]:
    chosen = [0]
    while len(chosen) < min(count, len(xyz)):
        best, farthest = 0, -1.0
        for point in range(len(xyz)):
            nearest = min(squared(xyz[point], xyz[other]) for other in chosen)
            if nearest > farthest:
                best, farthest = point, nearest
        chosen.append(best)
    return chosen


def reference_ball(xyz: np.ndarray, centre: int, radius_m: float, count: int, order: np.ndarray) -> list[int]:
    found = [int(point) for point in order if squared(xyz[point], xyz[centre]) <= radius_m**2][:count]
    return found + [found[0]] * (count - len(found))


def test_farthest_points_are_those_of_brute_force(xyz: np.ndarray) -> None:
    assert neighbourhoods.farthest_points(xyz, 24).tolist() == reference_fps(xyz, 24)
    # Fewer choices are the beginning of more.
    assert neighbourhoods.farthest_points(xyz, 5).tolist() == reference_fps(xyz, 24)[:5]


@pytest.mark.parametrize("radius_m", [0.5, 3.0, 8.0, 100.0])
def test_balls_are_those_of_brute_force(xyz: np.ndarray, radius_m: float) -> None:
    centres = neighbourhoods.farthest_points(xyz, 20)
    for order in (None, np.random.default_rng(1).permutation(len(xyz))):
        found = neighbourhoods.ball_query(xyz, centres, radius_m, 12, order)
        expected = np.arange(len(xyz)) if order is None else order
        assert found.tolist() == [reference_ball(xyz, int(centre), radius_m, 12, expected) for centre in centres]


def test_levels_build_on_each_other(xyz: np.ndarray) -> None:
    (first, _), (second, neighbours) = neighbourhoods.levels(
        xyz, [(40, 5.0, 8), (10, 12.0, 6)], np.random.default_rng(0)
    )
    centres = xyz[first]
    assert second.tolist() == reference_fps(centres, 10)
    order = np.arange(40)
    assert neighbours.tolist() == [reference_ball(centres, int(c), 12.0, 6, order) for c in second]
