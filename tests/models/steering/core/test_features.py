import itertools
import math

import pytest
import torch

from models.steering.core.features import (
    FEATURE_MIRROR_SIGNS,
    GEOMETRY,
    max_pool,
    mean_max_pool,
    node_features,
    sector_max_pool,
)
from pipeline.camera import classes


def test_classes_enter_in_proportion_to_semantics(make_batch):
    batch = make_batch([40])
    none, half, full = (node_features(batch.xyz, batch.cls, weight) for weight in (0.0, 0.5, 1.0))
    assert torch.equal(none[:, :GEOMETRY], full[:, :GEOMETRY])
    assert not none[:, GEOMETRY:].any()
    assert torch.equal(half[:, GEOMETRY:], full[:, GEOMETRY:] / 2)
    known = batch.cls < classes.COUNT
    assert torch.equal(full[known, GEOMETRY:].argmax(1), batch.cls[known].long())
    assert torch.equal(full[:, GEOMETRY:].sum(1), known.double())  # void has no class


def test_mirroring_changes_the_sign_of_lateral_features_only(make_batch):
    batch = make_batch([30])
    mirrored = batch.xyz * torch.tensor([-1.0, 1.0, 1.0])
    assert torch.equal(
        node_features(mirrored, batch.cls, 1.0),
        node_features(batch.xyz, batch.cls, 1.0) * torch.tensor(FEATURE_MIRROR_SIGNS),
    )


def test_pooling_is_mean_and_max_of_each_frame():
    x = torch.tensor([[1.0, -4.0], [3.0, -2.0], [5.0, -9.0]])
    pooled = mean_max_pool(x, torch.tensor([0, 2, 2, 3]))
    assert pooled.tolist() == [[2, -3, 3, -2], [0, 0, 0, 0], [5, -9, 5, -9]]
    assert torch.equal(max_pool(x, torch.tensor([0, 2, 2, 3])), pooled[:, 2:])


@pytest.mark.parametrize("counts", [[4, 4, 4], [1, 0, 9], [0, 0]])
def test_pooling_gradient(counts):
    x = torch.randn(sum(counts), 3, dtype=torch.float64, requires_grad=True)
    ptr = torch.tensor([0, *counts]).cumsum(0)
    assert torch.autograd.gradcheck(lambda x: mean_max_pool(x, ptr), x)


UNEQUAL = [30, 0, 1, 17]


def test_pooling_by_sector_equals_brute_force_and_mirroring_reverses_it(make_batch):
    """Five sectors of 18 degrees; points beside them belong to the outermost ones."""
    batch = make_batch(UNEQUAL)
    x = torch.rand(48, 3, dtype=torch.float64)
    x[3] = 0
    batch.xyz[:5, 0] = 0
    expected = torch.zeros(4, 5, 3, dtype=torch.float64)
    for frame, (start, stop) in enumerate(itertools.pairwise(batch.ptr.tolist())):
        for point in range(start, stop):
            right, _, ahead = batch.xyz[point].tolist()
            sector = min(4, max(0, math.floor((math.degrees(math.atan2(right, ahead)) + 45) / 18)))
            expected[frame, sector] = torch.maximum(expected[frame, sector], x[point])
    pooled = sector_max_pool(x, batch.xyz, batch.ptr, 5).view(4, 5, 3)
    assert torch.equal(pooled, expected)
    assert torch.equal(sector_max_pool(x, batch.mirrored().xyz, batch.ptr, 5).view(4, 5, 3), pooled.flip(1))


def test_pooling_by_sector_has_a_gradient(make_batch):
    batch = make_batch(UNEQUAL)
    x = torch.rand(48, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: sector_max_pool(x, batch.xyz, batch.ptr, 3), x)
