import torch

from models.steering.temporal.lstm import LSTM, Knobs

TOLERANCE = {"rtol": 0, "atol": 1e-9}


def test_lstm_equals_torch_forward_and_gradients():
    torch.manual_seed(0)
    cell = LSTM(5, Knobs(units=7)).double()
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
