import pytest

from models.steering.cell.cfc import CfC
from models.steering.cell.eq4 import Eq4
from models.steering.cell.ltc import LTC
from models.steering.core.wiring import Sizes
from models.steering.temporal.ncp import network


@pytest.mark.parametrize(("cell", "kind"), [("ltc", LTC), ("eq4", Eq4), ("cfc", CfC)])
def test_cell_names_the_kind_of_neuron(cell, kind):
    assert type(network(5, cell=cell)) is kind


def test_the_wiring_is_drawn_as_asked():
    assert network(5, wiring=Sizes(inter=9, command=7)).sensory.post.shape == (5 * 6, 1 + 7 + 9)


def test_an_unknown_cell_lists_the_known():
    with pytest.raises(ValueError, match=r"^cell = 'gru' .*cfc, eq4, ltc"):
        network(5, cell="gru")
