import numpy as np

from pipeline.camera.colours import FAR_M, NEAR_M, colourise_depth


def test_the_scale_of_depth_runs_from_red_to_blue_and_none_is_blank() -> None:
    near, far, none = colourise_depth(np.array([[NEAR_M, FAR_M, 0.0]]))[0].astype(int)
    assert near[0] > near[2] + 50
    assert far[2] > far[0]
    assert none.tolist() == [0, 0, 0, 0]


def test_what_lies_beyond_the_scale_has_the_colours_of_its_ends() -> None:
    beyond, ends = colourise_depth(np.array([[1.0, 500.0], [NEAR_M, FAR_M]]))
    np.testing.assert_array_equal(beyond, ends)
