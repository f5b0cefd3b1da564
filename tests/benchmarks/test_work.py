"""Counting, against sizes worked out by hand."""

import torch

from benchmarks.work import Counter, Work
from models.steering.core.adjacency import normalised_adjacency, propagate


def test_matrix_product_and_its_gradient() -> None:
    x, weight = torch.ones(5, 3), torch.ones(3, 7, requires_grad=True)
    with Counter() as counter:
        product = x @ weight
        assert counter.work == Work(2 * 5 * 3 * 7, 4 * (15 + 21 + 35), 1)
        gradient = torch.ones_like(product)
        before = counter.work
        product.backward(gradient)
    # x^T @ gradient: the transposed view is free, and x needs no gradient. The gradient, 21 numbers, may be copied.
    flop, moved_bytes, _ = (after - start for after, start in zip(counter.work, before, strict=True))
    assert flop == 2 * 3 * 5 * 7
    assert 4 * (15 + 35 + 21) <= moved_bytes <= 4 * (15 + 35 + 21) + 8 * 21


def test_a_sparse_product_counts_its_entries_alone() -> None:
    degree, indices = torch.tensor([1, 2, 1], dtype=torch.uint8), torch.tensor([1, 0, 2, 1])
    adjacency, x = normalised_adjacency(degree, indices, torch.float32), torch.ones(3, 5)
    with Counter() as counter:
        propagate(adjacency, x)
    entries = 4 + 3  # and the diagonal
    assert counter.work.flop == 2 * entries * 5
    assert counter.work.moved_bytes == 4 * 4 + entries * (4 + 4) + 2 * 4 * 15


def test_an_expanded_tensor_is_read_once_and_a_view_never() -> None:
    with Counter() as counter:
        torch.empty(1000)
        wide = torch.ones(1).expand(100).view(10, 10)
        before = counter.work
        wide.clone()
    assert before == Work(0, 4, 1)
    assert counter.work == Work(0, 4 + 4 + 400, 2)
