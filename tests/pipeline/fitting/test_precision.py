import pytest
import torch

from pipeline.fitting.precision import autocast


@pytest.mark.parametrize(
    ("precision", "dtype"), [("bfloat16", torch.bfloat16), ("float32", torch.float32), ("auto", torch.float32)]
)
def test_on_a_cpu_only_bfloat16_lowers_the_precision(precision: str, dtype: torch.dtype) -> None:
    x = torch.ones(2, 2)
    with autocast(x.device, precision):
        assert (x @ x).dtype == dtype
