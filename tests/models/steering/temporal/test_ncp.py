import pytest
import torch

from models.steering.core.knobs import Sizes
from models.steering.core.wiring import Layout
from models.steering.temporal.ncp import CELLS, Knobs


@pytest.mark.parametrize("cell", CELLS)
def test_knobs_choose_cell_and_wiring(cell):
    net = Knobs(cell=cell, wiring=Layout(inter=9, command=7)).build(Sizes(features=5))
    assert type(net) is CELLS[cell]
    _, state = net(net.sense(torch.zeros(1, 1, 5)), torch.full((1, 1), 0.1))
    assert sum(part.shape[1] for part in state) == 1 + 7 + 9
