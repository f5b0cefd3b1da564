"""Options of the networks: keys of a model's entry in params.yaml, with types and defaults."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn

from models.steering.core.batch import FrameKind, GraphBatch
from pipeline.base.errors import InputError

# Number of neurons or channels.
Count = Annotated[int, Field(ge=1, le=1024)]
# Channels after each layer.
Widths = Annotated[tuple[Count, ...], Field(min_length=1, max_length=32, strict=False)]
Semantics = Annotated[
    float,
    Field(
        ge=0,
        le=1,
        description="weight of the classes in the node features, λ of eq. 7. 0 is geometry alone",
    ),
]


class OptionGroup(BaseModel):
    """A group of options below a key, for example `wiring`."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Sizes:
    """Sizes that a network takes from its input and from the general keys of its entry."""

    features: int  # F, number of features per frame that the spatial network computes
    image_size: tuple[int, int] = (0, 0)  # (H,W) in pixels, of frames of kind image
    outputs: int = 1  # R, number of outputs per frame of the recurrent network


class NetworkOptions(OptionGroup):
    """Base class of the class `Options` in a network's file, which has a field for each option."""

    # Kind of frames that the network reads. Temporal networks have none.
    kind: ClassVar[FrameKind | None] = None
    # Whether the network's features depend on the frames.
    sees_frames: ClassVar[bool] = True
    # Whether the network reads the edges of a graph.
    reads_edges: ClassVar[bool] = False
    # Further columns of the points that the network reads, from GraphBatch.columns.
    reads_columns: ClassVar[tuple[str, ...]] = ()

    def build(self, sizes: Sizes) -> nn.Module:
        """Build the network with new weights from torch's random state.

        Raises InputError for a wrong option.
        """
        raise NotImplementedError

    def start(self, network: nn.Module) -> None:
        """Load weights into a network before its training. A trained checkpoint has them.

        Their files are in models/steering/weights, under the name of the network.
        """

    def prepare(self, batch: GraphBatch) -> Tensor | None:
        """Return what the network needs of each frame beside its points, [B, ...], or None.

        It reaches the network as ``GraphBatch.prepared``. The reader calls this method once per
        frame, before points are scaled or mirrored. What it returns for a frame must depend on
        this frame alone, and be valid for its mirror image, too. If it holds row numbers, they
        count within the frame.
        """
        return None


def network_names(part: Literal["spatial", "temporal"]) -> list[str]:
    """Return the names of the networks, each a file of models/steering/<part>."""
    folder = Path(__file__).parents[1] / part
    return sorted(file.stem for file in folder.glob("[!_]*.py"))


def load_options(part: Literal["spatial", "temporal"], name: str) -> type[NetworkOptions]:
    """Return the class `Options` of a network's file. Raises InputError if there is no file."""
    path = f"models/steering/{part}/{name}.py"
    names = network_names(part)
    if name not in names:
        raise InputError(f"{part} = {name!r}: there is no {path} (known: {', '.join(names)})")
    try:
        module = importlib.import_module(f"models.steering.{part}.{name}")
    # pydantic would take these exceptions, which are bugs in the file, for a wrong option.
    except (AssertionError, ValueError) as error:
        raise ImportError(f"{path} raises {error!r}") from error
    options: type[NetworkOptions] = module.Options
    return options
