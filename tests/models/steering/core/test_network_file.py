"""A network of one's own: a file beside the others, and nothing else."""

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from models.steering import spatial as spatial_folder
from models.steering import temporal as temporal_folder
from models.steering.core import steering_net
from models.steering.core.network_file import Network, load, names

GENERAL = {"input": "semantic", "temporal": "ncp", "window": 4, "features": 8, "equivariant": False}
WriteNetwork = Callable[..., None]
MEAN = '''
"""A network that ignores the graph: the mean place of a frame's points."""

import torch
from torch import nn

from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.knobs import Count

INPUT: Kind = "graph"


class network(nn.Module):
    def __init__(self, features: int, *, hidden: Count = 5, straight: bool = False) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(3, hidden), nn.Tanh(), nn.Linear(hidden, features))

    def forward(self, batch: GraphBatch) -> torch.Tensor:
        dtype = self.layers[0].weight.dtype
        frames = batch.xyz.to(dtype).split(batch.ptr.diff().tolist())
        return self.layers(torch.stack([frame.mean(0) for frame in frames]))
'''


@pytest.fixture
def write_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[WriteNetwork]:
    """write_network(name, text, part="spatial"): a file that lies as if in models/steering/<part>."""
    folders = {"spatial": spatial_folder, "temporal": temporal_folder}
    for part, package in folders.items():
        (tmp_path / part).mkdir()
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path / part)])
    before = set(sys.modules)

    def write(name: str, text: str, part: str = "spatial") -> None:
        (tmp_path / part / f"{name}.py").write_text(text)
        importlib.invalidate_caches()

    yield write
    for name in set(sys.modules) - before:
        part, _, own = name.removeprefix("models.steering.").partition(".")
        if part in folders and own:
            del sys.modules[name]
            vars(folders[part]).pop(own, None)


def test_a_new_file_is_a_network(make_batch, make_line, write_network):
    write_network("mean", MEAN)
    line = make_line("mean", hidden=7)
    assert line.keys() & {"layers", "semantics"} == set()
    assert steering_net.knobs(line)[:2] == ["hidden", "straight"]
    assert steering_net.resolved(line)["straight"] is False
    net = steering_net.build(line).double()
    assert net.spatial.layers[0].out_features == 7
    batch = make_batch([9, 12, 7, 9])
    dt_s = torch.full((1, 4), 0.1, dtype=torch.float64)
    assert net(batch, torch.arange(4)[None], dt_s).shape == (1,)
    with pytest.raises(ValueError, match=r"^hiden = 7 .*nothing to spatial: mean .*did you mean hidden"):
        steering_net.build({**make_line("mean"), "hiden": 7})
    with pytest.raises(ValueError, match=r"^hidden = 0: .*greater than or equal to 1"):
        steering_net.build({**line, "hidden": 0})
    with pytest.raises(ValueError, match=r"^spatial = 'meen' .*did you mean mean"):
        steering_net.build({**line, "spatial": "meen"})


def test_a_function_that_needs_to_know_its_window(make_line, write_network):
    text = (
        "from models.steering.temporal.lstm import LSTM\n\n\n"
        "def network(features, window, *, per_frame: int = 2):\n"
        "    return LSTM(features, units=window * per_frame)\n"
    )
    write_network("long", text, "temporal")
    net = steering_net.build(make_line("gnn", "long", window=6, per_frame=3))
    assert net.temporal.read_out.in_features == 18


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"own\.py defines no `network`"),
        ("network = 3", r"own\.py defines no `network`"),
        ("def network(features, **more): ...", r"own\.py: network takes \*\*more"),
        ("def network(features, *, hidden=3): ...", r"own\.py: knob hidden .* type"),
        ("def network(features, *, hidden: int): ...", r"own\.py: knob hidden .* default"),
        ("def network(features, hidden: int = 3): ...", r"own\.py: .*positional argument hidden.*features, window"),
        ("def network(features, levels): ...", r"own\.py: .*positional argument levels"),
        ("def network(features, *, window: int = 3): ...", r"^window is defined twice: .*own\.py"),
        ("def network(features, *, wiring: int = 3): ...", r"^wiring is defined twice: .*own\.py or .*ncp\.py"),
    ],
)
def test_a_file_that_is_not_as_it_should_be(write_network, text, message):
    write_network("own", f'INPUT = "graph"\n\n\n{text}\n')
    with pytest.raises(ValueError, match=message):
        steering_net.build({**GENERAL, "spatial": "own"})


@pytest.mark.parametrize("text", ["", 'INPUT = "points"\n'])
def test_a_spatial_network_says_what_it_expects(make_line, write_network, text):
    write_network("own", f"{text}def network(features): ...\n")
    with pytest.raises(ValueError, match=r"own\.py needs a line INPUT.*graph, pointnet2, image"):
        steering_net.build(make_line("own"))


def test_names_are_those_of_the_folder(write_network):
    assert {"gnn", "edgeconv", "gatv2", "pointnet2", "cnn"} <= set(names("spatial"))
    known = names("spatial")
    for name in ("a-b", "a b", "ä"):
        write_network(name, MEAN)
    assert names("spatial") == known


@pytest.mark.parametrize("name", ["../temporal/lstm", "..core.wiring", "__init__", "gnn.py", "", "os"])
def test_nothing_else_is_imported(name):
    with pytest.raises(ValueError, match=r"^spatial = "):
        load("spatial", name)
    with pytest.raises(ValueError, match=r"^spatial = "):
        Network("spatial", name)
