"""Neural circuit policy (Lechner et al. 2020): a small recurrent network on a sparse wiring."""

from collections.abc import Callable
from typing import Literal

from pydantic import Field

from models.steering.core.cell.eq4 import Eq4
from models.steering.core.cell.ltc import LTC
from models.steering.core.options import NetworkOptions, Sizes
from models.steering.core.recurrent import RecurrentCell
from models.steering.core.wiring import Layout, Wiring, ncp

# Name of a cell → class that builds it from a wiring.
CELLS: dict[str, Callable[[Wiring], RecurrentCell]] = {"ltc": LTC, "eq4": Eq4}


class Options(NetworkOptions):
    cell: Literal["ltc", "eq4"] = Field(
        default="ltc",
        description="equation of the neurons: `ltc` is the liquid time constant of ncps, `eq4` the "
        "paper's equation 4 as printed",
    )
    wiring: Layout = Layout()

    def build(self, sizes: Sizes) -> RecurrentCell:
        return CELLS[self.cell](ncp(sizes.features, self.wiring, sizes.outputs))
