"""The parts of a split recording."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.video.import_recording import GAP_S, cut


@given(st.integers(0, 200), st.integers(700, 1000), st.integers(20, 60), st.integers(20, 39))
def test_parts_have_their_share_of_the_time_and_a_gap_between_them(first: int, last: int, train: int, val: int) -> None:
    time_s, shares = np.arange(1000) / 10, (train, val, 100 - train - val)
    usable = (np.arange(1000) >= first) & (np.arange(1000) < last)
    parts = cut(usable, time_s, shares)
    for share, part in zip(shares, parts, strict=True):
        assert not (part & ~usable).any()
        gap_s = 0 if part is parts[-1] else GAP_S
        assert np.ptp(time_s[part]) == pytest.approx(share / 100 * (last - first - 1) / 10 - gap_s, abs=0.21)
    for before, after in pairwise(parts):
        assert time_s[after].min() - time_s[before].max() >= GAP_S


def test_a_part_of_less_than_two_images_is_refused() -> None:
    with pytest.raises(InputError, match="--split"):
        cut(np.ones(200, bool), np.arange(200) / 10, (98, 1, 1))
