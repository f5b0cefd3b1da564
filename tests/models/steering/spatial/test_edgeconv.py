import warnings

import pytest
import torch

from models.steering.spatial.edgeconv import EdgeConvLayer

with warnings.catch_warnings():  # PyG's own use of torch.jit is deprecated there, and not ours to mend
    warnings.simplefilter("ignore", DeprecationWarning)
    warnings.simplefilter("ignore", FutureWarning)
    from torch_geometric.nn import EdgeConv

TOLERANCE = {"rtol": 0, "atol": 1e-9}


@pytest.mark.parametrize("equal_rows", [False, True])
def test_equals_pyg_forward_and_gradients(make_batch, equal_rows):
    """With ReLU after our maximum and before PyG's; nodes that look alike, whose maxima tie, included."""
    torch.manual_seed(0)
    batch = make_batch([20, 0, 1, 11])
    node = torch.arange(32).repeat_interleave(batch.degree.long())
    layer = EdgeConvLayer(5, 8).double()
    peer = EdgeConv(torch.nn.Sequential(torch.nn.Linear(10, 8), torch.nn.ReLU())).double()
    peer.nn[0].load_state_dict(layer.linear.state_dict())
    x = torch.randn(32, 5, dtype=torch.float64)
    if equal_rows:  # in multiples of 1/8, so that equal sums are equal to the last bit
        x[1::2] = x[::2]
        for tensor in (x, *(parameter.data for parameter in (*layer.parameters(), *peer.parameters()))):
            tensor.mul_(8).round_().div_(8)
    x.requires_grad_()

    out = layer(x, EdgeConvLayer.operator(batch, x.dtype)).relu()
    expected = peer(x, torch.stack([batch.indices, node]))
    torch.testing.assert_close(out, expected, **TOLERANCE)
    assert not out[20].any()  # alone in its frame

    upstream = torch.randn_like(out)
    ours = torch.autograd.grad((out * upstream).sum(), [x, *layer.parameters()])
    theirs = torch.autograd.grad((expected * upstream).sum(), [x, *peer.parameters()])
    torch.testing.assert_close(ours, theirs, **TOLERANCE)
    assert all(gradient.abs().max() > 0.01 for gradient in ours)
