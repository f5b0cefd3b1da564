import pytest

from models.steering.core.knobs import Sizes
from models.steering.core.wiring import Layout
from models.steering.temporal.ncp import CELLS, Knobs


@pytest.mark.parametrize("cell", CELLS)
def test_knobs_choose_cell_and_wiring(cell):
    net = Knobs(cell=cell, wiring=Layout(inter=9, command=7)).build(Sizes(features=5))
    assert type(net) is CELLS[cell]
    assert net.wiring.sensory.shape == (5, 1 + 7 + 9)
