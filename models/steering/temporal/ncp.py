"""Neural circuit policy (Lechner et al. 2020): few neurons on a sparse wiring, of a kind that `cell` names."""

from models.steering.core.network_file import constructor, load
from models.steering.core.recurrent import RecurrentCell
from models.steering.core.wiring import Sizes, ncp


def network(features: int, *, cell: str = "ltc", wiring: Sizes = Sizes()) -> RecurrentCell:
    """Build the cell of models/steering/cell/<cell>.py: ltc, eq4 (the paper's, as printed) or cfc."""
    build = constructor(load("cell", cell), "cell")
    recurrent: RecurrentCell = build(ncp(features, wiring))
    return recurrent
