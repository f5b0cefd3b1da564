"""Section ``pictures``: what people look at."""

from pipeline.base.params import Count, Section


class Pictures(Section):
    key = "pictures"
    frames: Count
