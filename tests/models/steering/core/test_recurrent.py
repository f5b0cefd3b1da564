"""What every recurrent network does, whatever its neurons."""

import pytest
import torch

from models.steering.core.network_file import Network, names
from models.steering.core.recurrent import RecurrentCell

TOLERANCE = {"rtol": 0, "atol": 1e-9}
EACH = [*((name, {}) for name in names("temporal")), *(("ncp", {"cell": name}) for name in names("cell"))]


def cell_of(temporal: str, knobs: dict[str, str]) -> RecurrentCell:
    torch.manual_seed(0)
    network = Network("temporal", temporal)
    return network.build({"features": 5, "window": 9}, network.settings(knobs)).double()


@pytest.mark.parametrize(("temporal", "knobs"), EACH)
def test_streaming_equals_windowed_when_the_state_is_carried(temporal, knobs):
    cell = cell_of(temporal, knobs)
    x = torch.randn(2, 9, 5, dtype=torch.float64)
    dt_s = torch.rand(2, 9, dtype=torch.float64) * 0.2 + 0.05
    whole, last = cell(cell.sense(x), dt_s)

    state, pieces = None, []
    for frames in (slice(0, 1), slice(1, 5), slice(5, 9)):
        out, state = cell(cell.sense(x[:, frames]), dt_s[:, frames], state)
        pieces.append(out)
    torch.testing.assert_close(torch.cat(pieces, dim=1), whole, **TOLERANCE)
    torch.testing.assert_close(state, last, **TOLERANCE)
    assert whole.shape == (2, 9, 1)
    assert not torch.allclose(cell(cell.sense(x[:, 5:]), dt_s[:, 5:])[0], whole[:, 5:])  # the state matters


@pytest.mark.parametrize(("temporal", "knobs"), EACH)
def test_windows_do_not_see_each_other(temporal, knobs):
    cell = cell_of(temporal, knobs)
    x = torch.randn(4, 3, 5, dtype=torch.float64)
    dt_s = torch.rand(4, 3, dtype=torch.float64) + 0.05
    alone = torch.cat([cell(cell.sense(x[w : w + 1]), dt_s[w : w + 1])[0] for w in range(4)])
    torch.testing.assert_close(cell(cell.sense(x), dt_s)[0], alone, **TOLERANCE)
