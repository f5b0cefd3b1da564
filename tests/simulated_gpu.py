"""Tensors that claim to be on a GPU: real values on the CPU, with launches, copies and waits counted.

with simulated_gpu.Gpu() as gpu:
    gpu.move(net)
    ...
print(gpu.launches, gpu.moved_bytes, gpu.copies, gpu.synchronisations)

An operator is one launch, unless it only returns a view or allocates; a _foreach operator on lists is one. A real GPU
launches at least as many kernels. `moved_bytes` assumes that each operator reads its inputs from memory and writes its
results there. An operator on tensors of both devices raises an error.
"""

import warnings
from collections import Counter
from contextlib import ExitStack
from typing import Any, Self
from unittest import mock

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils import _foreach_utils
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map_only

GPU = torch.device("cuda", 0)
ALLOCATIONS = {"empty", "new_empty", "empty_like", "empty_strided", "new_empty_strided", "_unsafe_view", "lift_fresh"}
SPARSE_CSR = {"sparse_compressed_tensor", "_sparse_compressed_tensor_unsafe", "_sparse_csr_tensor_unsafe"}  # no kernels
WAITING = {"_local_scalar_dense", "nonzero", "masked_select", "bincount", "_unique2", "unique_dim", "is_nonzero"}


class OnGpu(Tensor):
    """A tensor whose `device` is GPU. `values` is on the CPU; to torch's C++ code, the device is "meta"."""

    values: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, values: Tensor) -> "OnGpu":
        dense = values.layout == torch.strided
        tensor: OnGpu = Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls,
            values.shape,
            strides=values.stride() if dense else None,
            storage_offset=values.storage_offset() if dense else None,
            dtype=values.dtype,
            device="meta",
        )
        tensor.values = values
        return tensor

    @property
    def device(self) -> torch.device:  # type: ignore[override]
        return GPU

    def __repr__(self) -> str:  # type: ignore[override]
        return f"OnGpu({self.values!r})"

    @classmethod
    def __torch_dispatch__(cls, operator: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise RuntimeError(f"{operator}: a tensor on the simulated GPU is used outside of Gpu")


class Gpu(TorchDispatchMode):
    """A context in which a GPU is simulated. Tensors in `pinned` may be copied without waiting."""

    def __init__(self) -> None:
        super().__init__()
        self.operators: Counter[str] = Counter()  # launches by operator
        self.moved_bytes = 0
        self.copies: list[str] = []  # blocking copies to the GPU
        self.synchronisations: list[str] = []
        self._pinned: dict[int, Tensor] = {}
        self._stack = ExitStack()

    @property
    def launches(self) -> int:
        return self.operators.total()

    def reset(self) -> None:
        """Start counting again."""
        for record in (self.operators, self.copies, self.synchronisations):
            record.clear()
        self.moved_bytes = 0

    def move(self, net: nn.Module) -> None:
        """Move a network's parameters and buffers to the simulated GPU."""
        for module in net.modules():
            for name, parameter in module._parameters.items():
                if parameter is not None:
                    module._parameters[name] = nn.Parameter(OnGpu(parameter.detach()))
            for name, buffer in module._buffers.items():
                if buffer is not None:
                    module._buffers[name] = OnGpu(buffer)

    def pin(self, tensor: Tensor) -> Tensor:
        """Treat a tensor as pinned memory."""
        self._pinned[tensor.data_ptr()] = tensor
        return tensor

    def __enter__(self) -> Self:
        types = [Tensor, nn.Parameter, OnGpu]
        for place in ("torch.optim.optimizer", "torch.utils._foreach_utils"):
            self._stack.enter_context(mock.patch(f"{place}._foreach_supported_types", types))
        devices = [*_foreach_utils._get_foreach_kernels_supported_devices(), "meta"]
        for place in ("torch.optim.optimizer", "torch.utils._foreach_utils", "torch.optim.swa_utils"):
            self._stack.enter_context(
                mock.patch(f"{place}._get_foreach_kernels_supported_devices", return_value=devices)
            )
        self._stack.enter_context(mock.patch("torch.cuda._lazy_init", return_value=None))
        # Inference mode passes composite operators, such as `to`, which launch nothing themselves.
        self._stack.enter_context(mock.patch("torch.inference_mode", torch.no_grad))
        self._stack.enter_context(mock.patch.object(Tensor, "pin_memory", lambda tensor: self.pin(tensor)))
        self._stack.enter_context(warnings.catch_warnings())
        warnings.filterwarnings("ignore", message="User provided device_type of 'cuda'")
        self._stack.enter_context(_Functions(self))
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._stack.close()

    def __torch_dispatch__(self, operator: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        name, tensors = operator._schema.name.removeprefix("aten::"), _tensors((args, kwargs))
        on_gpu = any(isinstance(tensor, OnGpu) for tensor in tensors)
        target = kwargs.get("device")
        if target is not None:
            kwargs["device"] = torch.device("cpu")
        if name == "_to_copy" or name == "copy_":
            return self._copy(operator, name, target, args, kwargs)
        result_on_gpu = on_gpu if target is None else torch.device(target).type in ("cuda", "meta")
        if not result_on_gpu and not on_gpu:
            return operator(*args, **kwargs)
        if not name.startswith("_foreach"):  # an optimiser's step counters may stay on the CPU
            mixed = [tensor for tensor in tensors if not isinstance(tensor, OnGpu) and tensor.ndim]
            if mixed:
                raise RuntimeError(f"{operator}: tensors of both devices, on the CPU {[t.shape for t in mixed]}")
        launches = self.launches
        self._count(operator, name, args, kwargs)
        result = _wrap(operator(*_unwrap(args), **_unwrap(kwargs)), args, kwargs)
        if self.launches > launches:
            self.moved_bytes += sum(map(_bytes, tensors + _tensors(result)))
        return result

    def _copy(self, operator: Any, name: str, target: Any, args: Any, kwargs: Any) -> Any:
        source = args[1] if name == "copy_" else args[0]
        before = isinstance(source, OnGpu)
        if name == "copy_":
            after = isinstance(args[0], OnGpu)
        else:
            after = before if target is None else torch.device(target).type in ("cuda", "meta")
        if before and not after:
            self.synchronisations.append(f"{operator} to the CPU")
        elif after and not before and source.ndim + (name == "_to_copy"):
            if not (kwargs.get("non_blocking") and source.data_ptr() in self._pinned):
                self.copies.append(f"{operator} {tuple(source.shape)}")
        elif after and (name == "copy_" or source.dtype != kwargs.get("dtype", source.dtype)):
            self.operators[name] += 1
        result = operator(*_unwrap(args), **_unwrap(kwargs))
        if name == "copy_":
            return args[0]
        return OnGpu(result) if after else result

    def _count(self, operator: Any, name: str, args: Any, kwargs: Any) -> None:
        returns = operator._schema.returns
        is_view = bool(returns) and returns[0].alias_info is not None and not returns[0].alias_info.is_write
        if is_view or name in ALLOCATIONS or name in SPARSE_CSR or name == "detach":
            return
        masks = name in ("index", "index_put_") and any(
            index is not None and index.dtype in (torch.bool, torch.uint8) for index in args[1]
        )
        unknown_size = name == "repeat_interleave" and kwargs.get("output_size") is None
        if name in WAITING or masks or unknown_size:
            self.synchronisations.append(str(operator))
        self.operators[name] += 1


class _Functions(TorchFunctionMode):
    """Functions that torch's C++ code would not run on a tensor subclass."""

    def __init__(self, gpu: Gpu) -> None:
        super().__init__()
        self._gpu = gpu

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        name = getattr(function, "__name__", "")
        if args and isinstance(args[0], OnGpu):
            if name == "new_tensor":
                self._gpu.copies.append(f"new_tensor({args[1]})")
                return OnGpu(torch.tensor(args[1], dtype=kwargs.get("dtype", args[0].dtype)))
            if name in ("tolist", "numpy"):
                return getattr(args[0].cpu(), name)()
        if name == "sparse_csr_tensor" and isinstance(args[0], OnGpu):
            return OnGpu(function(*_unwrap(args), **_unwrap(kwargs)))
        if name == "tensor" and "cuda" in str(kwargs.get("device")):
            self._gpu.copies.append(f"tensor({args[0]})")
            return OnGpu(torch.tensor(args[0], **{**kwargs, "device": "cpu"}))
        if name == "to" and len(args) > 1 and isinstance(args[1], Tensor):
            return args[0].to(args[1].device, args[1].dtype, **kwargs)
        return function(*args, **kwargs)


def _tensors(tree: Any) -> list[Tensor]:
    return [leaf for leaf in tree_flatten(tree)[0] if isinstance(leaf, Tensor)]


def _bytes(tensor: Tensor) -> int:
    values = tensor.values if isinstance(tensor, OnGpu) else tensor
    if values.layout == torch.sparse_csr:
        return sum(part.nbytes for part in (values.crow_indices(), values.col_indices(), values.values()))
    return min(values.nbytes, values.untyped_storage().nbytes())  # an expanded tensor has fewer than its elements


def _unwrap(tree: Any) -> Any:
    return tree_map_only(OnGpu, lambda tensor: tensor.values, tree)


def _wrap(result: Any, args: Any, kwargs: Any) -> Any:
    """Return an operator's result on the GPU; an argument that was changed in place is returned itself."""
    arguments = {id(tensor.values): tensor for tensor in _tensors((args, kwargs)) if isinstance(tensor, OnGpu)}
    return tree_map_only(
        Tensor, lambda tensor: arguments[id(tensor)] if id(tensor) in arguments else OnGpu(tensor), result
    )
