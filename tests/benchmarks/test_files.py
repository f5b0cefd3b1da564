"""The table of encodings: what is stored can be undone."""

import numpy as np

from benchmarks import files


def test_what_is_stored_says_the_same_points_and_neighbours() -> None:
    rng = np.random.default_rng(0)
    xyz = (rng.integers(-80 * 1024, 80 * 1024, (50, 3)) / 1024).astype(np.float32)
    made = files.encodings(xyz)
    np.testing.assert_array_equal(made["int32 steps"] / 1024, xyz)
    np.testing.assert_array_equal(made["int32 differences"].cumsum(axis=0) / 1024, xyz)
    assert np.abs(made["int16 of 4 mm"] / 256 - xyz).max() <= 0.002
    degree = np.array([2, 1, 3], np.uint8)
    indices = np.array([5, 65_000, 0, 1, 2, 9], np.uint16)
    made = files.differences(indices, degree)
    np.testing.assert_array_equal(made["less the last"].cumsum(dtype=np.uint16), indices)
    np.testing.assert_array_equal(made["less the node"] + np.array([0, 0, 1, 2, 2, 2], np.uint16), indices)
