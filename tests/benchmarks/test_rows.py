"""Each row of `make bench` runs on small inputs, and both sides of a row compute the same."""

import json
from pathlib import Path

import pytest
import torch

from benchmarks import bench, networks
from benchmarks import street as measuring
from benchmarks.street import Street, make_street
from models.steering.spatial.gnn import GCN, Options
from pipeline.base.errors import InputError

POINTS = 150


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Street:
    return make_street(tmp_path_factory.mktemp("street") / "graphs.h5", POINTS)


def test_all_rows_are_measured_with_one_thread_into_a_new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "ROUNDS", 1)
    monkeypatch.setattr(networks, "REPEATS", 1)
    torch.set_num_threads(2)
    out = tmp_path / "results.json"
    bench.main(points=POINTS, out=out)
    assert torch.get_num_threads() == 1
    rows = json.loads(out.read_text())["rows"]
    assert [*rows] == bench.ROWS
    assert all(row["ours"] > 0 and row["alternative"] > 0 for row in rows.values())
    before = out.read_bytes()
    with pytest.raises(InputError, match="--out"):
        bench.main(points=POINTS, out=out)
    assert out.read_bytes() == before


def test_a_row_has_medians_of_turns_and_the_factor_by_which_this_project_is_better() -> None:
    ours, other = iter([99.0, 1, 9, 2, 3, 2]), iter([99.0, 8, 4, 7, 7, 7])  # the first turn warms up
    row = measuring.compare(lambda: next(ours), lambda: next(other), "ms", "")
    assert (row.ours, row.alternative, row.ratio) == (2, 7, 3.5)
    assert measuring.row(8, 2, "windows/s", "").ratio == 4


def test_frames_saved_for_pyg_hold_the_same_graph(street: Street, tmp_path: Path) -> None:
    data = [torch.load(path, weights_only=False) for path in networks.save(street, tmp_path, 2)]
    batch, start = street.batch(2), len(data[0].pos)
    torch.testing.assert_close(torch.cat([frame.pos for frame in data]), batch.xyz, rtol=0, atol=0)
    joined = torch.cat([data[0].edge_index, data[1].edge_index + start], dim=1)
    torch.testing.assert_close(joined, batch.edge_index, rtol=0, atol=0)


@pytest.mark.parametrize("csr", [False, True])
def test_pyg_layers_compute_the_same(street: Street, csr: bool) -> None:
    torch.manual_seed(0)
    net, batch = GCN(1, Options(semantics=0.0)), street.batch(3)
    graph = (networks.sparse(batch),) if csr else networks.normalised(batch)
    expected = net.read_out(networks.pooled(networks.pyg_layers(net), graph, batch)).tanh()
    torch.testing.assert_close(net(batch), expected, rtol=1e-4, atol=1e-5)
