"""Section ``pictures``: pictures of a few frames."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Section

FewFrames = Annotated[int, Field(ge=0, le=1000)]


class Frames(Section):
    """Frames per drive of each split, evenly spread over the drive."""

    train: FewFrames
    val: FewFrames
    test: FewFrames


class Pictures(Section):
    key = "pictures"
    frames: Frames
