import pytest
import torch

from models.steering.core.recurrent import LSTM, RecurrentCell
from models.steering.core.steering_net import CELL
from models.steering.core.wiring import ncp

TOLERANCE = {"rtol": 0, "atol": 1e-9}
CELLS = ["lstm", *sorted(CELL)]


def cell_of(name: str) -> RecurrentCell:
    torch.manual_seed(0)
    return (LSTM(5, 7) if name == "lstm" else CELL[name](ncp(5))).double()


def test_lstm_equals_torch_forward_and_gradients():
    cell = cell_of("lstm")
    peer = torch.nn.LSTM(5, 7, batch_first=True).double()
    for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh"):
        getattr(peer, f"{name}_l0").data = getattr(cell, name).data.clone()
    x = torch.randn(3, 6, 5, dtype=torch.float64, requires_grad=True)
    h0, c0 = torch.randn(2, 3, 7, dtype=torch.float64)

    out, (h, c) = cell(cell.sense(x), torch.full((3, 6), 0.1), (h0, c0))
    hidden, (h_peer, c_peer) = peer(x, (h0[None], c0[None]))
    expected = cell.read_out(hidden)
    torch.testing.assert_close(out, expected, **TOLERANCE)
    torch.testing.assert_close((h, c), (h_peer[0], c_peer[0]), **TOLERANCE)

    ours = torch.autograd.grad(out.square().sum(), [x, cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh])
    peers = torch.autograd.grad(expected.square().sum(), [x, *peer.parameters()])
    torch.testing.assert_close(ours, peers, **TOLERANCE)


@pytest.mark.parametrize("name", CELLS)
def test_streaming_equals_windowed_when_the_state_is_carried(name):
    cell = cell_of(name)
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


@pytest.mark.parametrize("name", CELLS)
def test_windows_do_not_see_each_other(name):
    cell = cell_of(name)
    x = torch.randn(4, 3, 5, dtype=torch.float64)
    dt_s = torch.rand(4, 3, dtype=torch.float64) + 0.05
    alone = torch.cat([cell(cell.sense(x[w : w + 1]), dt_s[w : w + 1])[0] for w in range(4)])
    torch.testing.assert_close(cell(cell.sense(x), dt_s)[0], alone, **TOLERANCE)
