import numpy as np
import pytest

from models.steering.core.wiring import Sizes, ncp


def test_default_is_the_papers_driver():
    wiring = ncp(32)
    assert (wiring.motor, wiring.command, wiring.inter, wiring.units) == (1, 6, 12, 19)
    motor, command, inter = slice(0, 1), slice(1, 7), slice(7, 19)
    sensory, internal = np.abs(wiring.sensory), np.abs(wiring.internal)
    assert (sensory[:, inter].sum(1) == 6).all()
    assert (internal[inter, command].sum(1) == 4).all()
    assert internal[command, command].sum() == 6
    assert internal[command, motor].sum() == 6
    # and nothing else
    assert sensory.sum() == 32 * 6
    assert internal.sum() == 12 * 4 + 6 + 6
    assert set(np.unique(wiring.internal)) == set(np.unique(wiring.sensory)) == {-1, 0, 1}


def test_seed_decides():
    assert all(np.array_equal(a, b) for a, b in [(ncp(8, Sizes(seed=3)).sensory, ncp(8, Sizes(seed=3)).sensory)])
    assert np.array_equal(ncp(8, Sizes(seed=3)).internal, ncp(8, Sizes(seed=3)).internal)
    assert not np.array_equal(ncp(8, Sizes(seed=3)).internal, ncp(8, Sizes(seed=4)).internal)


@pytest.mark.parametrize("seed", range(20))
def test_no_neuron_is_forgotten(seed):
    wiring = ncp(2, Sizes(inter=15, command=7, sensory_fanout=1, inter_fanout=1, motor_fanin=2, seed=seed), motor=2)
    commands, inters = slice(2, 9), slice(9, 24)
    assert wiring.sensory[:, inters].any(0).all()  # every inter neuron hears a feature
    assert wiring.internal[inters, commands].any(0).all()  # every command neuron hears an inter neuron
    assert wiring.internal[commands, :2].any(0).all()  # every motor neuron hears a command neuron
    assert wiring.internal[commands, :2].any(1).all()  # every command neuron is heard
    assert (np.abs(wiring.internal[commands, :2]).sum(0) >= 2).all()


def test_both_signs_are_drawn_alike():
    signs = np.concatenate([ncp(32, Sizes(seed=seed)).sensory.ravel() for seed in range(20)])
    assert abs(signs.sum()) < 4 * np.sqrt(np.abs(signs).sum())  # 4 standard deviations


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"motor_fanin": 7}, "^wiring.motor_fanin = 7, but there are command = 6"),
        ({"inter_fanout": 9}, "inter_fanout = 9, but there are command = 6"),
        ({"sensory_fanout": 13}, "sensory_fanout = 13, but there are inter = 12"),
        ({"recurrent_command_synapses": 37}, "room for 0 to 36"),
    ],
)
def test_impossible_wiring(choice, message):
    with pytest.raises(ValueError, match=message):
        ncp(32, Sizes(**choice))
