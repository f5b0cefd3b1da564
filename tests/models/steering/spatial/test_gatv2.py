import warnings

import pytest
import torch

from models.steering.spatial.gatv2 import GATv2Layer

with warnings.catch_warnings():  # PyG's own use of torch.jit is deprecated there, and not ours to mend
    warnings.simplefilter("ignore", DeprecationWarning)
    warnings.simplefilter("ignore", FutureWarning)
    from torch_geometric.nn import GATv2Conv

TOLERANCE = {"rtol": 0, "atol": 1e-9}


@pytest.mark.parametrize(("outputs", "heads"), [(8, 4), (6, 2), (5, 1)])
def test_equals_pyg_forward_and_gradients(make_batch, outputs, heads):
    torch.manual_seed(0)
    batch = make_batch([20, 0, 1, 11])
    node = torch.arange(32).repeat_interleave(batch.degree.long())
    layer = GATv2Layer(3, outputs).double()
    with torch.no_grad():
        for parameter in layer.parameters():
            parameter.normal_()
    peer = GATv2Conv(3, outputs // heads, heads=heads, add_self_loops=True).double()
    peer.lin_l.load_state_dict(layer.left.state_dict())
    peer.lin_r.load_state_dict(layer.right.state_dict())
    peer.att.data, peer.bias.data = layer.attention.data[None].clone(), layer.bias.data.clone()
    x = torch.randn(32, 3, dtype=torch.float64, requires_grad=True)

    out = layer(x, GATv2Layer.operator(batch, x.dtype))
    expected = peer(x, torch.stack([batch.indices, node]))
    torch.testing.assert_close(out, expected, **TOLERANCE)
    torch.testing.assert_close(out[20], layer.left(x[20]) + layer.bias, **TOLERANCE)  # alone: hears itself

    upstream = torch.randn_like(out)
    mine = [layer.attention, layer.bias, *layer.left.parameters(), *layer.right.parameters()]
    peers = [peer.att, peer.bias, *peer.lin_l.parameters(), *peer.lin_r.parameters()]
    gradients = torch.autograd.grad((out * upstream).sum(), [x, *mine])
    for ours, theirs in zip(gradients, torch.autograd.grad((expected * upstream).sum(), [x, *peers]), strict=True):
        torch.testing.assert_close(ours, theirs.view_as(ours), **TOLERANCE)
        assert ours.abs().max() > 0.01
