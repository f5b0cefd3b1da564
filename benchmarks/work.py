"""Counts what torch does, from shapes: the same numbers on every machine."""

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import flop_registry


class Work(NamedTuple):
    """flop: of matrix products and convolutions. moved_bytes: if each operator reads all its inputs from memory and
    writes its result there. operators: how many ran; on a GPU each is at least one kernel launch.
    """

    flop: int
    moved_bytes: int
    operators: int


_FREE = (torch.ops.aten.empty, torch.ops.aten.empty_like, torch.ops.aten.sparse_compressed_tensor)  # no data moves


class Counter(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Counts the operators that run while it is active, backward passes too. Views and new memory cost nothing."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.work = Work(0, 0, 0)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        out = func(*args, **kwargs)
        if func.is_view or func.overloadpacket in _FREE:
            return out
        tensors = [leaf for leaf in tree_leaves((args, kwargs, out)) if isinstance(leaf, Tensor)]
        flop, moved_bytes, operators = self.work
        self.work = Work(flop + _flop(func, args, kwargs, out), moved_bytes + sum(map(_bytes, tensors)), operators + 1)
        return out


def _flop(func: Any, args: Any, kwargs: Any, out: Any) -> int:
    if any(isinstance(arg, Tensor) and arg.layout == torch.sparse_csr for arg in args):
        matrix, x = args
        return 2 * matrix.values().numel() * x.shape[1]
    count = flop_registry.get(func.overloadpacket)
    return int(count(*args, **kwargs, out_val=out)) if count else 0


def _bytes(tensor: Tensor) -> int:
    if tensor.layout == torch.sparse_csr:
        return sum(part.nbytes for part in (tensor.crow_indices(), tensor.col_indices(), tensor.values()))
    return min(tensor.nbytes, tensor.untyped_storage().nbytes())  # one number seen as many is read once
