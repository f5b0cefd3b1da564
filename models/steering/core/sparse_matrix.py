"""A weight matrix with parameters only where a wiring has synapses."""

from torch import Tensor, nn


class SparseMatrix(nn.Module):
    """Matrix [P,U] that is zero except at S positions; their S values are its parameters.

    Args:
        values: [P,U], initial; read where `exists`.
        exists: bool [P,U].
    """

    place: Tensor

    def __init__(self, values: Tensor, exists: Tensor) -> None:
        super().__init__()
        self.shape = exists.shape
        self.register_buffer("place", exists.flatten().nonzero()[:, 0])  # [S]; saved with the weights
        self.w = nn.Parameter(values[exists])  # [S], in row order

    def dense(self) -> Tensor:
        """Return [P,U]. At an NCP's size a dense product is faster than a sparse one."""
        return self.w.new_zeros(self.shape.numel()).scatter(0, self.place, self.w).view(self.shape)
