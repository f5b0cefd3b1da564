"""A user's network: one file beside the others."""

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from models.steering import spatial as spatial_folder
from models.steering.core import steering_net
from models.steering.core.network_file import load, names
from pipeline.base.errors import InputError
from pipeline.sections.models import Model, resolve

WriteNetwork = Callable[[str, str], None]
MEAN = '''
"""Mean position of a frame's points."""

from typing import ClassVar

import torch
from torch import nn

from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.knobs import Count, NetworkKnobs, Sizes


class Mean(nn.Module):
    def __init__(self, features: int, hidden: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(3, hidden), nn.Tanh(), nn.Linear(hidden, features))

    def forward(self, batch: GraphBatch) -> torch.Tensor:
        frames = batch.xyz.to(self.layers[0].weight.dtype).split(batch.ptr.diff().tolist())
        return self.layers(torch.stack([frame.mean(0) for frame in frames]))


class Knobs(NetworkKnobs):
    kind: ClassVar[Kind] = "graph"
    hidden: Count = 5
    straight: bool = False

    def build(self, sizes: Sizes) -> nn.Module:
        return Mean(sizes.features, self.hidden)
'''


@pytest.fixture
def write_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[WriteNetwork]:
    """write_network(name, text): write a file as in models/steering/spatial/."""
    monkeypatch.setattr(spatial_folder, "__path__", [*spatial_folder.__path__, str(tmp_path)])
    before = set(sys.modules)

    def write(name: str, text: str) -> None:
        (tmp_path / f"{name}.py").write_text(text)
        importlib.invalidate_caches()

    yield write
    for name in set(sys.modules) - before:
        if name.startswith("models.steering.spatial."):
            del sys.modules[name]
            vars(spatial_folder).pop(name.rpartition(".")[2], None)


def test_new_file_is_a_network(make_batch, make_line, write_network):
    write_network("mean", MEAN)
    line = make_line("mean", hidden=7)
    resolved = resolve(Model.model_validate(line))
    assert (resolved["hidden"], resolved["straight"]) == (7, False)
    net = steering_net.build(line).double()
    dt_s = torch.full((1, 4), 0.1, dtype=torch.float64)
    assert net(make_batch([9, 12, 7, 9]), torch.arange(4)[None], dt_s).shape == (1,)
    assert net.spatial.layers[0].out_features == 7
    for wrong, words in (({"hiden": 7}, "did you mean hidden"), ({"hidden": 0}, "greater than or equal to 1")):
        with pytest.raises(InputError, match=words) as raised:
            resolve(Model.model_validate(line | wrong))
        assert next(iter(wrong)) in str(raised.value)


@pytest.mark.parametrize("name", ["../temporal/lstm", "..core.wiring", "__init__", "gnn.py", "", "os", "a-b", "ä"])
def test_only_files_of_the_folder_are_imported(write_network, name):
    for odd in ("a-b", "ä"):
        write_network(odd, MEAN)
    with pytest.raises(ValueError, match=r"^spatial = .*known: blind, cnn, edgeconv, gatv2, gnn, pointnet2\)"):
        load("spatial", name)
    assert name not in names("spatial")
