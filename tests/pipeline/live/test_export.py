"""Exported programs equal the network on real frames."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from models.steering.core.batch import GraphBatch, pad
from models.steering.core.features import mean_max_pool
from models.steering.core.options import Sizes
from models.steering.core.steering_net import SteeringNet
from models.steering.spatial import blind, edgeconv, gatv2, gnn, polar
from models.steering.temporal.lstm import LSTM
from pipeline.base.errors import InputError
from pipeline.live.export import Spatial, export, read_examples
from tests.pipeline.live import untrained

POINTS = 50
SIZES = Sizes(features=6)
NETWORKS = [
    gnn.Options(layers=(32, 8), semantics=1.0).build(SIZES),  # wider than its input, then narrower
    gnn.Options(layers=(16,)).build(SIZES),
    edgeconv.Options(layers=(16, 8), semantics=0.5).build(SIZES),
    gatv2.Options(layers=(16, 6), semantics=1.0).build(SIZES),  # four heads, and two
    gnn.Options(layers=(16,), sectors=5).build(SIZES),
    blind.Options().build(SIZES),
    polar.Options(widths=(4, 8)).build(SIZES),
]


def frame() -> GraphBatch:
    """Return a random graph; some points, the first and the last among them, have no neighbours."""
    torch.manual_seed(0)
    edges = torch.rand(POINTS, POINTS) < 0.1
    edges = (edges | edges.T).fill_diagonal_(False)
    isolated = torch.tensor([0, 1, 17, POINTS - 1])
    edges[isolated], edges[:, isolated] = False, False
    xyz, trainid = 20 * torch.randn(POINTS, 3), torch.randint(0, 19, (POINTS,), dtype=torch.uint8)
    return GraphBatch(
        xyz, trainid, torch.tensor([0, POINTS]), edges.sum(1).to(torch.uint8), edges.nonzero()[:, 1].int()
    )


@pytest.mark.parametrize("equivariant", [False, True])
@pytest.mark.parametrize("network", NETWORKS, ids=lambda network: type(network).__name__)
def test_the_module_equals_the_network(network: nn.Module, equivariant: bool) -> None:
    net, batch = SteeringNet(network, LSTM(6), equivariant), frame()
    arrays = pad({name: getattr(batch, name).numpy() for name in ("xyz", "cls", "degree", "indices")})
    with torch.no_grad():
        features = Spatial(net, [*arrays])(*map(torch.from_numpy, arrays.values()))
        torch.testing.assert_close(features, net.encode(batch), rtol=0, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"spatial": "gnn", "temporal": "ncp", "equivariant": True, "motion": "visual"},
        {"spatial": "gatv2", "temporal": "ncp", "cell": "eq4", "sectors": 5},
        {"spatial": "polar", "equivariant": True},
        {"spatial": "pointnet2", "equivariant": True},
        {"spatial": "cnn", "motion": "visual", "base": "none"},
    ],
    ids=lambda settings: settings["spatial"],
)
def test_each_kind_of_network_is_exported(tmp_path: Path, settings: dict[str, Any]) -> None:
    """The programs run without this project, on frames of other sizes, and repeat their results."""
    model, out = untrained.model(tmp_path, **settings), tmp_path / "out"
    manifest = export(model, tmp_path / "graphs/semantic", out, 1e-5)
    assert json.loads((out / "export.json").read_text()) == json.loads(json.dumps(manifest))
    assert {path.name for path in out.iterdir()} == {"spatial.pt2", "recurrent.pt2", "export.json"}
    measured = settings.get("motion") == "visual" and settings.get("base") != "none"
    assert manifest["base_rad"] == ("measured angle of the last frame" if measured else "0")
    spatial, recurrent = (torch.export.load(out / f"{part}.pt2").module() for part in manifest["inputs"])
    example = read_examples(model, tmp_path / "graphs/semantic")[-1]
    inputs = [[torch.from_numpy(each[name]) for name in manifest["inputs"]["spatial"]] for each in example.frames]
    features = {torch.cat([spatial(*each) for each in inputs]).numpy().tobytes() for _ in range(5)}
    assert len(features) == 1
    window = [torch.from_numpy(example.window[name]) for name in manifest["inputs"]["recurrent"]]
    window[0] = torch.from_numpy(np.frombuffer(features.pop(), np.float32).reshape(window[0].shape).copy())
    assert float(recurrent(*window)[0]) == pytest.approx(example.output, abs=1e-5)


class Height(nn.Module):
    """The network of docs/models.md, which knows nothing about export."""

    def __init__(self) -> None:
        super().__init__()
        self.read_out = nn.Linear(6, 8)

    def forward(self, batch: GraphBatch) -> torch.Tensor:
        return torch.tanh(self.read_out(mean_max_pool(batch.xyz, batch.ptr)))


def test_a_control_is_not_exported(tmp_path: Path) -> None:
    model = untrained.model(tmp_path, "blind", scene="another")
    with pytest.raises(InputError, match="model net: scene: another is a control for evaluation"):
        export(model, tmp_path / "graphs/semantic", tmp_path / "out", 1e-5)


@pytest.mark.slow
def test_a_new_network_needs_nothing_for_export(tmp_path: Path) -> None:
    model = untrained.model(tmp_path, "blind")
    model.net.spatial = Height()
    manifest = export(model, tmp_path / "graphs/semantic", tmp_path / "out", 1e-5)
    assert manifest["largest_difference"]["spatial"] < 1e-6


def test_only_an_unchanged_export_is_replaced(tmp_path: Path) -> None:
    model, out = untrained.model(tmp_path, "blind"), tmp_path / "out"

    def run() -> None:
        export(model, tmp_path / "graphs/semantic", out, 1e-5)

    run()
    run()
    (out / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"no export wrote: thesis\.tex"):
        run()
    (out / "thesis.tex").rename(out / "spatial.pt2")
    with pytest.raises(InputError, match=r"no export wrote: spatial\.pt2"):
        run()
    assert (out / "spatial.pt2").read_text() == "years of work"
    for text in ("{}", '{"sha256": ["spatial.pt2"]}', "[]", ""):
        (out / "export.json").write_text(text)
        with pytest.raises(InputError):
            run()
    (out / "export.json").unlink()
    with pytest.raises(InputError, match="is not an earlier export"):
        run()
    assert (out / "spatial.pt2").read_text() == "years of work"
