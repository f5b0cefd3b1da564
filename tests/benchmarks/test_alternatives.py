"""Both benchmarks on small inputs, both sides computing the same, and the fit of Udacity's steering
wheel.
"""

import numpy as np
import pytest
import torch

from benchmarks import alternatives, card
from models.steering.spatial import gnn


@pytest.fixture(autouse=True)
def _small_street(monkeypatch):
    small = alternatives.VARIANT.model_copy(update={"points": 150})
    monkeypatch.setattr(alternatives, "VARIANT", small)


def test_all_rows_are_measured_with_one_thread(monkeypatch, capsys):
    monkeypatch.setattr(alternatives, "ROUNDS", 1)
    torch.set_num_threads(2)
    alternatives.networks()
    assert torch.get_num_threads() == 1
    lines = capsys.readouterr().out.splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines[4:]]
    assert len(rows) == 3
    for _, ours_ms, alternative_ms, ratio in rows:
        assert float(ours_ms) > 0 < float(alternative_ms)
        assert float(ratio) == pytest.approx(float(alternative_ms) / float(ours_ms), rel=0.02)

    torch.set_num_threads(2)
    card.main()
    assert torch.get_num_threads() == 1
    lines = capsys.readouterr().out.splitlines()[-2:]
    values = [float(line.rsplit(": ", 1)[1]) for line in lines]
    assert len(values) == 2
    assert min(values) > 0


def test_pyg_gets_the_same_graph_and_computes_the_same(monkeypatch, tmp_path):
    monkeypatch.setattr(alternatives, "DEVICE", "cpu")
    street = alternatives.write_street(tmp_path)
    batch = alternatives.read_graphs(street, 2)
    first, second = batch.blocks(1)
    expected_edges = torch.cat([first.edge_index, second.edge_index + len(first.xyz)], dim=1)
    assert torch.equal(batch.edge_index, expected_edges)

    torch.manual_seed(0)
    net = gnn.GCN(alternatives.FEATURES, gnn.Options(semantics=1.0))
    each_layer = alternatives.pyg_gcn(normalize=True)
    once = alternatives.pyg_gcn(normalize=False)
    for peer in (each_layer, once):
        peer.read_out = net.read_out
        for layer, ours in zip(peer.layers, net.layers, strict=True):
            layer.lin.weight.data = ours.weight.data.T.clone()
            layer.bias.data = ours.bias.data
    expected = net(batch)
    torch.testing.assert_close(each_layer(batch), expected, rtol=1e-4, atol=1e-5)
    computed = alternatives.normalised_once(once, batch)
    torch.testing.assert_close(computed, expected, rtol=1e-4, atol=1e-5)


def test_gain_offset_and_lag_are_found():
    time_s = np.arange(600) / 10
    measured_rad = 0.2 * np.sin(time_s / 3)
    # The measurement lags behind the wheel by a frame.
    wheel_rad = 42.0 * np.interp(time_s + 0.1, time_s, measured_rad) + 0.02
    # Beyond FITTED_S, the wheel's angles are not read.
    unknown_rad = np.where(time_s < alternatives.FITTED_S, wheel_rad, np.nan)
    found_rad = alternatives.fit_wheel(time_s, measured_rad, unknown_rad)
    assert found_rad == pytest.approx(wheel_rad, rel=1e-3, abs=1e-3)
