"""All recurrent networks; LSTM compared with torch's."""

import pytest
import torch

from models.steering.core.options import Sizes
from models.steering.temporal import lstm, ncp
from models.steering.temporal.lstm import LSTM, Options

TOLERANCE = {"rtol": 0, "atol": 1e-9}


@pytest.fixture(params=["lstm", *ncp.CELLS])
def cell(request):
    torch.manual_seed(0)
    options = lstm.Options() if request.param == "lstm" else ncp.Options(cell=request.param)
    return options.build(Sizes(features=5, window=9)).double()


def test_windows_are_independent_and_equal_pieces_with_carried_state(cell):
    x = torch.randn(4, 9, 5, dtype=torch.float64)
    dt_s = torch.rand(4, 9, dtype=torch.float64) * 0.2 + 0.05
    complete, last = cell(cell.project_inputs(x), dt_s)
    assert complete.shape == (4, 9, 1)
    alone = torch.cat([cell(cell.project_inputs(x[w : w + 1]), dt_s[w : w + 1])[0] for w in range(4)])
    torch.testing.assert_close(complete, alone, **TOLERANCE)

    state, pieces = None, []
    for frames in (slice(0, 1), slice(1, 5), slice(5, 9)):
        out, state = cell(cell.project_inputs(x[:, frames]), dt_s[:, frames], state)
        pieces.append(out)
    torch.testing.assert_close(torch.cat(pieces, dim=1), complete, **TOLERANCE)
    torch.testing.assert_close(state, last, **TOLERANCE)
    assert not torch.allclose(cell(cell.project_inputs(x[:, 5:]), dt_s[:, 5:])[0], complete[:, 5:])  # the state matters


def test_lstm_equals_torch_forward_and_gradients():
    torch.manual_seed(0)
    cell = LSTM(5, Options(units=7)).double()
    peer = torch.nn.LSTM(5, 7, batch_first=True).double()
    for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh"):
        getattr(peer, f"{name}_l0").data = getattr(cell, name).data.clone()
    x = torch.randn(3, 6, 5, dtype=torch.float64, requires_grad=True)
    h0, c0 = torch.randn(2, 3, 7, dtype=torch.float64)

    out, (h, c) = cell(cell.project_inputs(x), torch.full((3, 6), 0.1), (h0, c0))
    hidden, (h_peer, c_peer) = peer(x, (h0[None], c0[None]))
    expected = cell.read_out(hidden)
    torch.testing.assert_close(out, expected, **TOLERANCE)
    torch.testing.assert_close((h, c), (h_peer[0], c_peer[0]), **TOLERANCE)

    ours = torch.autograd.grad(out.square().sum(), [x, cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh])
    peers = torch.autograd.grad(expected.square().sum(), [x, *peer.parameters()])
    torch.testing.assert_close(ours, peers, **TOLERANCE)
