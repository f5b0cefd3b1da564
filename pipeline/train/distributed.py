"""Processes of one training run, as started by `torchrun`."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import torch
    from torch import Tensor

T = TypeVar("T")


@dataclass(frozen=True)
class World:
    """Rank of this process and number of processes; by default a single one."""

    rank: int = 0
    size: int = 1

    @property
    def is_main(self) -> bool:
        """Whether this process prints and writes."""
        return self.rank == 0

    def share(self, count: int) -> list[int]:
        """Return this process's part of `count` indices; empty if there are too few."""
        return list(range(self.rank, count, self.size))

    def mean(self, tensor: "Tensor") -> "Tensor":
        """Average the processes' tensors, in place."""
        if self.size > 1:
            from torch import distributed

            distributed.all_reduce(tensor)
            tensor /= self.size
        return tensor

    def gather(self, part: T) -> list[T]:
        """Return the processes' parts in the order of their ranks."""
        if self.size == 1:
            return [part]
        from torch import distributed

        parts: list[T] = [part] * self.size
        distributed.all_gather_object(parts, part)
        return parts


@contextmanager
def process_group() -> Iterator[tuple[World, "torch.device"]]:
    """Join the processes started by torchrun; yield rank and size, and this process's GPU or the CPU."""
    import torch
    from torch import distributed

    cuda = torch.cuda.is_available()
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0))) if cuda else torch.device("cpu")
    if int(os.environ.get("WORLD_SIZE", 1)) == 1:
        yield World(), device
        return
    if cuda:
        torch.cuda.set_device(device)
    distributed.init_process_group("nccl" if cuda else "gloo")
    try:
        yield World(distributed.get_rank(), distributed.get_world_size()), device
    finally:
        distributed.destroy_process_group()
