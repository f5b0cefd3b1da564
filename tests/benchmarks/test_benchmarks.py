"""Rows of make bench on small inputs, both sides computing the same, and the fit of Udacity's
steering wheel.
"""

import numpy as np
import pytest
import torch
from torch_geometric.nn.conv.gcn_conv import gcn_norm

from benchmarks import bench, networks, timing, udacity
from models.steering.core.features import node_features
from models.steering.spatial.gnn import GCN, Options
from pipeline.base.errors import InputError

POINTS = 150


def test_all_rows_are_measured_with_one_thread(monkeypatch, capsys):
    monkeypatch.setattr(timing, "ROUNDS", 1)
    monkeypatch.setattr(networks, "REPEATS", 1)
    torch.set_num_threads(2)
    bench.main(points=POINTS)
    assert torch.get_num_threads() == 1
    lines = capsys.readouterr().out.splitlines()
    rows = [line.split(" | ") for line in lines[3 : 3 + len(bench.ROWS)]]
    assert [row[0] for row in rows] == [f"| {name}" for name in bench.ROWS]
    assert all(float(row[1]) > 0 < float(row[2]) for row in rows)
    figures = {
        text: float(value.strip(" |"))
        for _, text, value in (line.split(" | ") for line in lines[-6:])
    }
    assert figures.pop("outputs, largest difference to the CPU's") <= 1e-4
    assert len(figures) == 5
    assert min(figures.values()) > 0
    with pytest.raises(InputError, match="'lct': did you mean ltc"):
        bench.main(["lct"])


def test_pyg_gets_the_same_graph_and_computes_the_same(tmp_path):
    made = timing.make_street(tmp_path, POINTS)
    data = [torch.load(path, weights_only=False) for path in made.frames[:2]]
    batch, start = made.batch(2), len(data[0].pos)
    assert torch.equal(torch.cat([frame.pos for frame in data]), batch.xyz)
    assert torch.equal(
        torch.cat([data[0].edge_index, data[1].edge_index + start], dim=1), batch.edge_index
    )
    torch.manual_seed(0)
    net = GCN(1, Options(semantics=0.0))
    x, graph = (
        node_features(batch.xyz, batch.cls, 0.0),
        gcn_norm(batch.edge_index, None, len(batch.xyz)),
    )
    expected = networks.features(x, networks.pyg_layers(net), graph, batch.ptr, net.read_out)
    torch.testing.assert_close(net(batch), expected, rtol=1e-4, atol=1e-5)


def test_gain_offset_and_lag_are_found():
    time_s = np.arange(600) / 10
    measured = 0.2 * np.sin(time_s / 3)
    wheel = udacity.Wheel(gain=42.0, offset_rad=0.02, lag_s=0.1)  # the wheel leads by a frame
    found = udacity.fit(time_s, measured, wheel.angle(time_s, measured))
    assert found == pytest.approx(wheel, rel=1e-3, abs=1e-3)
