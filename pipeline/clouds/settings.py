"""Section ``clouds``: semantic point clouds."""

from pipeline.base.params import Count, Positive, Section, Seed


class Clouds(Section):
    max_points: Count
    max_depth_m: Positive
    seed: Seed
