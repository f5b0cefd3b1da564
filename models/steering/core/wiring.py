"""Wiring of a neural circuit policy: signed synapses between neurons (Lechner et al. 2020), and
their weights.
"""

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.options import Count, OptionGroup
from pipeline.base.errors import InputError


class Wiring(NamedTuple):
    """Signed synapses as matrices int8 [from, to]: +1 excites, -1 inhibits, 0 is no synapse.

    Neurons are numbered motor, command, inter, as in ncps. sensory [D,U]: from input features;
    internal [U,U].
    """

    sensory: np.ndarray
    internal: np.ndarray
    motor: int


class Layout(OptionGroup):
    """Option `wiring`: neurons per layer, synapses per neuron, and the seed of the random
    choice.
    """

    inter: Count = 12
    command: Count = 6
    sensory_fanout: Count = 6
    inter_fanout: Count = 4
    recurrent_command_synapses: Annotated[int, Field(ge=0)] = 6
    motor_fanin: Count = 6
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None  # null: the training run's seed


def ncp(inputs: int, layout: Layout = Layout(), motor: int = 1) -> Wiring:
    """Draw the four-layer wiring sensory → inter → command (⟲) → motor; equal seeds give equal
    wirings, None is 0.

    Each sensory neuron feeds `sensory_fanout` inter neurons, each inter neuron `inter_fanout`
    command neurons, and each motor neuron is fed by `motor_fanin` command neurons. A neuron without
    input after that, or a command neuron without output, gets the average number of synapses of its
    layer. Raises InputError if a fan-out or fan-in exceeds the size of its target layer, or for too
    many recurrent synapses.
    """
    inter, command = layout.inter, layout.command
    for name, count, layer, size in [
        ("sensory_fanout", layout.sensory_fanout, "inter", inter),
        ("inter_fanout", layout.inter_fanout, "command", command),
        ("motor_fanin", layout.motor_fanin, "command", command),
        ("recurrent_command_synapses", layout.recurrent_command_synapses, "command²", command**2),
    ]:
        if count > size:
            raise InputError(f"wiring.{name} = {count}, expected at most {layer} = {size}")

    rng = np.random.default_rng(layout.seed or 0)
    units = motor + command + inter
    sensory = np.zeros((inputs, units), dtype=np.int8)
    internal = np.zeros((units, units), dtype=np.int8)
    motors, commands, inters = np.split(np.arange(units), [motor, motor + command])

    _fan_out(rng, sensory, np.arange(inputs), inters, layout.sensory_fanout)
    _fan_out(rng, internal, inters, commands, layout.inter_fanout)
    for place in rng.choice(command**2, size=layout.recurrent_command_synapses, replace=False):
        internal[commands[place // command], commands[place % command]] = rng.choice([-1, 1])
    # transposed: fan-in is fan-out of the targets
    _fan_out(rng, internal.T, motors, commands, layout.motor_fanin)
    return Wiring(sensory, internal, motor)


def _fan_out(
    rng: np.random.Generator,
    matrix: np.ndarray,
    sources: np.ndarray,
    targets: np.ndarray,
    fanout: int,
) -> None:
    """Connect each source to `fanout` random targets, then targets without input to the average
    number.
    """
    for source in sources:
        chosen = rng.choice(targets, size=fanout, replace=False)
        matrix[source, chosen] = rng.choice([-1, 1], size=fanout)
    average = int(np.clip(len(sources) * fanout // len(targets), 1, len(sources)))
    for target in targets[~matrix[np.ix_(sources, targets)].any(axis=0)]:
        chosen = rng.choice(sources, size=average, replace=False)
        matrix[chosen, target] = rng.choice([-1, 1], size=average)


class SparseMatrix(nn.Module):
    """Matrix [P,U] that is zero except where `exists`, at S positions; their S values are its
    parameters.
    """

    place: Tensor

    def __init__(self, values: Tensor, exists: Tensor) -> None:
        super().__init__()
        self.shape = exists.shape
        # [S]; saved with the weights
        self.register_buffer("place", exists.flatten().nonzero()[:, 0])
        self.w = nn.Parameter(values[exists])  # [S], in row order

    def dense(self) -> Tensor:
        """Return [P,U]. At an NCP's size a dense product is faster than a sparse one."""
        return self.w.new_zeros(self.shape.numel()).scatter(0, self.place, self.w).view(self.shape)
