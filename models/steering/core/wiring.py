"""Wiring of a neural circuit policy: which neuron listens to which, and with what sign (Lechner et al. 2020)."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from models.steering.core.knobs import Count, Group, Seed

Polarity = NDArray[np.int8]
Neurons = NDArray[np.int64]


@dataclass(frozen=True)
class Wiring:
    """Signed synapses as matrices [from, to]: +1 excites, -1 inhibits, 0 is no synapse.

    Neurons are numbered motor, command, inter (as ncps does). sensory [D,U]: from input features; internal [U,U].
    """

    sensory: Polarity
    internal: Polarity
    motor: int
    command: int
    inter: int

    @property
    def units(self) -> int:
        """U, the number of neurons without the sensory ones."""
        return self.motor + self.command + self.inter


class Sizes(Group):
    """Knob `wiring`: neurons of each layer, synapses of each neuron, and the seed of the draw."""

    inter: Count = 12
    command: Count = 6
    sensory_fanout: Count = 6
    inter_fanout: Count = 4
    recurrent_command_synapses: Annotated[int, Field(ge=0)] = 6
    motor_fanin: Count = 6
    seed: Seed = 0


def ncp(inputs: int, sizes: Sizes = Sizes(), motor: int = 1) -> Wiring:
    """Draw the four-layer wiring sensory → inter → command (⟲) → motor; the same seed draws the same wiring.

    Every sensory neuron feeds `sensory_fanout` inter neurons, every inter neuron `inter_fanout` command neurons, and
    every motor neuron listens to `motor_fanin` command neurons. A neuron that the draw left without input, or a command
    neuron without listener, gets as many synapses as its layer has on average.

    Raises:
        ValueError: a fan-out or fan-in of more than the layer that it reaches, too many recurrent synapses.
    """
    inter, command = sizes.inter, sizes.command
    for name, count, layer, size in [
        ("sensory_fanout", sizes.sensory_fanout, "inter", inter),
        ("inter_fanout", sizes.inter_fanout, "command", command),
        ("motor_fanin", sizes.motor_fanin, "command", command),
    ]:
        if count > size:
            raise ValueError(f"wiring.{name} = {count}, but there are {layer} = {size} neurons: choose 1 to {size}")
    if sizes.recurrent_command_synapses > command**2:
        raise ValueError(
            f"wiring.recurrent_command_synapses = {sizes.recurrent_command_synapses}, "
            f"but command = {command} neurons have room for 0 to {command**2}"
        )

    rng = np.random.default_rng(sizes.seed)
    units = motor + command + inter
    sensory = np.zeros((inputs, units), dtype=np.int8)
    internal = np.zeros((units, units), dtype=np.int8)
    motors, commands, inters = np.split(np.arange(units), [motor, motor + command])

    _fan_out(rng, sensory, np.arange(inputs), inters, sizes.sensory_fanout)
    _fan_out(rng, internal, inters, commands, sizes.inter_fanout)
    for place in rng.choice(command**2, size=sizes.recurrent_command_synapses, replace=False):
        internal[commands[place // command], commands[place % command]] = rng.choice([-1, 1])
    _fan_out(rng, internal.T, motors, commands, sizes.motor_fanin)  # transposed: fan-in is the fan-out of the listeners
    return Wiring(sensory, internal, motor, command, inter)


def _fan_out(rng: np.random.Generator, matrix: Polarity, sources: Neurons, targets: Neurons, fanout: int) -> None:
    """Connect each source to `fanout` random targets, then each forgotten target to an average number of sources."""
    for source in sources:
        chosen = rng.choice(targets, size=fanout, replace=False)
        matrix[source, chosen] = rng.choice([-1, 1], size=fanout)
    average = int(np.clip(len(sources) * fanout // len(targets), 1, len(sources)))
    for target in targets[~matrix[np.ix_(sources, targets)].any(axis=0)]:
        chosen = rng.choice(sources, size=average, replace=False)
        matrix[chosen, target] = rng.choice([-1, 1], size=average)
