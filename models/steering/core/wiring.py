"""Wiring of a neural circuit policy (Lechner et al. 2020): signed synapses between neurons."""

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.options import Count, OptionGroup
from pipeline.base.errors import InputError


class Wiring(NamedTuple):
    """Signed synapses as matrices int8 [from, to]: +1 excites, -1 inhibits, 0 is no synapse.

    The U neurons are numbered as in ncps: motor neurons first, then command neurons, then inter
    neurons.
    """

    sensory: np.ndarray  # [D,U], synapses from the D input features
    internal: np.ndarray  # [U,U], synapses between neurons
    motor: int  # number of motor neurons


class Layout(OptionGroup):
    """Option `wiring`: neurons per layer, synapses per neuron, and the seed that chooses them."""

    inter: Count = Field(default=12, description="inter neurons")
    command: Count = Field(default=6, description="command neurons")
    sensory_fanout: Count = Field(
        default=6, description="inter neurons that each feature feeds, at most `inter`"
    )
    inter_fanout: Count = Field(
        default=4, description="command neurons that each inter neuron feeds, at most `command`"
    )
    recurrent_command_synapses: int = Field(
        default=6, ge=0, description="synapses among command neurons, at most `command`²"
    )
    motor_fanin: Count = Field(
        default=6, description="command neurons that feed each motor neuron, at most `command`"
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = Field(
        default=None, description="seed of the wiring. `null` is the seed of the training"
    )


def ncp(inputs: int, layout: Layout = Layout(), motor: int = 1) -> Wiring:
    """Draw the four-layer wiring sensory → inter → command → motor.

    Each sensory neuron, which is an input feature, feeds `sensory_fanout` inter neurons. Each inter
    neuron feeds `inter_fanout` command neurons, which have `recurrent_command_synapses` among
    themselves. Each motor neuron is fed by `motor_fanin` command neurons. A neuron that has no
    input after that, or a command neuron that has no output, gets the average number of synapses of
    its layer. Equal seeds give equal wirings; the seed None counts as 0. Raises InputError if a
    fan-out, a fan-in or the number of recurrent synapses is too large for the layers.
    """
    inter = layout.inter
    command = layout.command
    for name, count, layer, size in [
        ("sensory_fanout", layout.sensory_fanout, "inter", inter),
        ("inter_fanout", layout.inter_fanout, "command", command),
        ("motor_fanin", layout.motor_fanin, "command", command),
        ("recurrent_command_synapses", layout.recurrent_command_synapses, "command²", command**2),
    ]:
        if count > size:
            raise InputError(f"wiring.{name} = {count}, expected at most {layer} = {size}")

    units = motor + command + inter
    motors, commands, inters = np.split(np.arange(units), [motor, motor + command])
    sensory = np.zeros((inputs, units), dtype=np.int8)
    internal = np.zeros((units, units), dtype=np.int8)
    rng = np.random.default_rng(layout.seed or 0)

    _fan_out(rng, sensory, np.arange(inputs), inters, layout.sensory_fanout)
    _fan_out(rng, internal, inters, commands, layout.inter_fanout)
    for place in rng.choice(command**2, size=layout.recurrent_command_synapses, replace=False):
        source, target = divmod(place, command)
        internal[commands[source], commands[target]] = rng.choice([-1, 1])
    # The fan-in of motor neurons is their fan-out on the transposed matrix.
    _fan_out(rng, internal.T, motors, commands, layout.motor_fanin)
    return Wiring(sensory, internal, motor)


def _fan_out(
    rng: np.random.Generator,
    matrix: np.ndarray,
    sources: np.ndarray,
    targets: np.ndarray,
    fanout: int,
) -> None:
    """Connect each source to `fanout` random targets; give each target an input."""
    for source in sources:
        chosen = rng.choice(targets, size=fanout, replace=False)
        matrix[source, chosen] = rng.choice([-1, 1], size=fanout)

    # A target that no source has chosen gets the average number of inputs.
    average = int(np.clip(len(sources) * fanout // len(targets), 1, len(sources)))
    has_input = matrix[np.ix_(sources, targets)].any(axis=0)
    for target in targets[~has_input]:
        chosen = rng.choice(sources, size=average, replace=False)
        matrix[chosen, target] = rng.choice([-1, 1], size=average)


class SparseMatrix(nn.Module):
    """Matrix [P,U] with S parameters, at the places where `exists` is true; other values are 0."""

    place: Tensor

    def __init__(self, values: Tensor, exists: Tensor) -> None:
        super().__init__()
        self.shape = exists.shape
        # Places [S] in the flattened matrix, saved with the weights.
        self.register_buffer("place", exists.flatten().nonzero()[:, 0])
        self.w = nn.Parameter(values[exists])  # [S], in row order

    def dense(self) -> Tensor:
        """Return the matrix as a dense tensor [P,U].

        At the size of an NCP, a product with a dense matrix is faster than with a sparse one.
        """
        zeros = self.w.new_zeros(self.shape.numel())
        return zeros.scatter(0, self.place, self.w).view(self.shape)
