from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.camera import classes
from pipeline.perception.perceive import load, passes, perceive, read, save
from tests import street


@pytest.fixture(scope="module")
def model() -> UnifiedEncoder:
    torch.manual_seed(1)
    return UnifiedEncoder("small").eval()


def test_a_saved_encoder_loads_unchanged_and_its_file_is_deterministic(model: UnifiedEncoder, tmp_path: Path) -> None:
    save(tmp_path, "small", model.state_dict())
    assert read(tmp_path / "encoder.pt").backbone == "small"
    loaded = load(tmp_path)
    assert not loaded.training
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, loaded.state_dict()[name].cpu()), name
    save(tmp_path / "other", "small", loaded.state_dict())  # it runs with channels last
    assert (tmp_path / "other/encoder.pt").read_bytes() == (tmp_path / "encoder.pt").read_bytes()


def test_batched_equals_single(model: UnifiedEncoder) -> None:
    images = np.stack([street.scene(frame)[0] for frame in range(3)])
    depth, cls = perceive(model, images, street.CAMERA)
    for i in range(3):
        one_depth, one_cls = perceive(model, images[i : i + 1], street.CAMERA)
        np.testing.assert_allclose(one_depth[0], depth[i], rtol=1e-5)
        assert (one_cls[0] != cls[i]).mean() < 1e-3  # ties
    assert (depth.dtype, cls.dtype) == (np.float32, np.uint8)
    assert cls.max() < classes.COUNT


@pytest.fixture
def set_threads() -> Iterator[Callable[[int], None]]:
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def test_passes_give_the_same_bits_for_any_number_of_threads(
    set_threads: Callable[[int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEER_WORKERS", "5")
    matrices = np.random.default_rng(0).standard_normal((6, 300, 300), np.float32)
    results = []
    for threads in (1, 2, 5):
        set_threads(threads)
        inside = set()

        def forward(matrix: np.ndarray, inside: set[int] = inside) -> np.ndarray:
            inside.add(torch.get_num_threads())
            product: np.ndarray = (torch.from_numpy(matrix) @ torch.from_numpy(matrix)).sum(0).numpy()
            return product

        results.append(np.stack(list(passes(forward, (matrix for matrix in matrices)))))
        assert inside == {1}
        assert torch.get_num_threads() == threads
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])
