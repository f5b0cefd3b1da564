import numpy as np
import pytest

from models.steering.core.wiring import Layout, ncp


def test_default_is_the_wiring_of_the_paper():
    wiring = ncp(32)
    assert (wiring.motor, wiring.command, wiring.inter, wiring.units) == (1, 6, 12, 19)
    motor, command, inter = slice(0, 1), slice(1, 7), slice(7, 19)
    sensory, internal = np.abs(wiring.sensory), np.abs(wiring.internal)
    assert (sensory[:, inter].sum(1) == 6).all()
    assert (internal[inter, command].sum(1) == 4).all()
    assert internal[command, command].sum() == 6
    assert internal[command, motor].sum() == 6
    assert sensory.sum() == 32 * 6
    assert internal.sum() == 12 * 4 + 6 + 6
    assert set(np.unique(wiring.internal)) == set(np.unique(wiring.sensory)) == {-1, 0, 1}


def test_equal_seeds_give_equal_wirings():
    first, again, other = (ncp(8, Layout(seed=seed)) for seed in (3, 3, 4))
    assert (first.sensory == again.sensory).all()
    assert (first.internal == again.internal).all()
    assert (first.internal != other.internal).any()


@pytest.mark.parametrize("seed", range(20))
def test_each_neuron_has_input_and_output(seed):
    wiring = ncp(2, Layout(inter=15, command=7, sensory_fanout=1, inter_fanout=1, motor_fanin=2, seed=seed), motor=2)
    commands, inters = slice(2, 9), slice(9, 24)
    assert wiring.sensory[:, inters].any(0).all()
    assert wiring.internal[inters, commands].any(0).all()
    assert wiring.internal[commands, :2].any(0).all()
    assert wiring.internal[commands, :2].any(1).all()
    assert (np.abs(wiring.internal[commands, :2]).sum(0) >= 2).all()
