"""Contract of all recurrent networks."""

import pytest
import torch

from models.steering.core.knobs import Sizes
from models.steering.temporal import lstm, ncp

TOLERANCE = {"rtol": 0, "atol": 1e-9}


@pytest.fixture(params=["lstm", *ncp.CELLS])
def cell(request):
    torch.manual_seed(0)
    knobs = lstm.Knobs() if request.param == "lstm" else ncp.Knobs(cell=request.param)
    return knobs.build(Sizes(features=5, window=9)).double()


def test_windows_are_independent_and_equal_pieces_with_carried_state(cell):
    x = torch.randn(4, 9, 5, dtype=torch.float64)
    dt_s = torch.rand(4, 9, dtype=torch.float64) * 0.2 + 0.05
    complete, last = cell(cell.sense(x), dt_s)
    assert complete.shape == (4, 9, 1)
    alone = torch.cat([cell(cell.sense(x[w : w + 1]), dt_s[w : w + 1])[0] for w in range(4)])
    torch.testing.assert_close(complete, alone, **TOLERANCE)

    state, pieces = None, []
    for frames in (slice(0, 1), slice(1, 5), slice(5, 9)):
        out, state = cell(cell.sense(x[:, frames]), dt_s[:, frames], state)
        pieces.append(out)
    torch.testing.assert_close(torch.cat(pieces, dim=1), complete, **TOLERANCE)
    torch.testing.assert_close(state, last, **TOLERANCE)
    assert not torch.allclose(cell(cell.sense(x[:, 5:]), dt_s[:, 5:])[0], complete[:, 5:])  # the state matters
