import sys
import threading
from collections.abc import Callable, Generator
from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.encoder.perceive import load, passes, perceive, read, save, stored_depth
from tests import street


@pytest.fixture
def model() -> UnifiedEncoder:
    torch.manual_seed(1)
    return UnifiedEncoder("small").eval()


def test_an_encoder_comes_back_bit_by_bit_and_its_file_is_deterministic(model: UnifiedEncoder, tmp_path: Path) -> None:
    save(tmp_path, "small", model.state_dict())
    assert read(tmp_path / "encoder.pt").backbone == "small"
    loaded = load(tmp_path)
    assert not loaded.training
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, loaded.state_dict()[name].cpu()), name
    save(tmp_path / "other", "small", loaded.state_dict())  # it runs with channels last
    assert (tmp_path / "other/encoder.pt").read_bytes() == (tmp_path / "encoder.pt").read_bytes()


def test_other_content_is_refused_with_the_command_that_mends_it(model: UnifiedEncoder, tmp_path: Path) -> None:
    path = tmp_path / "encoder.pt"
    with pytest.raises(InputError, match=r"is missing\. .*dvc repro --force --single-item encoder$"):
        load(tmp_path)
    save(tmp_path, "small", model.state_dict())
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 3])
    with pytest.raises(InputError, match=r"cut short.*dvc repro --force --single-item encoder$"):
        load(tmp_path)
    net = {"conv.weight": torch.zeros(3)}
    for other in (net, {"kind": "unified encoder"}, {"kind": "unified encoder", "net": net}):
        torch.save(other, path)
        with pytest.raises(InputError, match=r"checkpoint|lacks the backbone"):
            read(path)
    torch.save({"kind": "unified encoder", "backbone": "small", "net": {0: net["conv.weight"]}}, path)
    with pytest.raises(InputError, match="tensors"):
        read(path)
    save(tmp_path, "smal", {})
    with pytest.raises(InputError, match=r"'smal'.*small.*dvc repro --force --single-item encoder$"):
        load(tmp_path)
    save(tmp_path, "small", net)
    with pytest.raises(InputError, match=r"does not fit.*dvc repro --force --single-item encoder$"):
        load(tmp_path)


def test_a_package_that_is_missing_is_asked_for_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "transformers", None)
    save(tmp_path, "swin-t", {})
    with pytest.raises(InputError, match=r"pip install '\.\[pretrained\]'$"):
        load(tmp_path)


def test_batched_equals_single(model: UnifiedEncoder) -> None:
    images = np.stack([street.scene(frame)[0] for frame in range(5)])
    depth, cls = perceive(model, images, street.K)
    for i in range(5):
        one_depth, one_cls = perceive(model, images[i : i + 1], street.K)
        np.testing.assert_allclose(one_depth[0], depth[i], rtol=1e-5)
        assert (one_cls[0] != cls[i]).mean() < 1e-3  # a tie may fall either way
    assert depth.dtype == np.float32
    assert cls.dtype == np.uint8
    assert cls.max() < classes.COUNT


@pytest.fixture
def restore_threads() -> Generator[Callable[[int], None]]:
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.slow
def test_passes_give_the_same_bits_for_any_number_of_threads(restore_threads: Callable[[int], None]) -> None:
    torch.manual_seed(1)
    model = UnifiedEncoder("dinov2-vits14").eval()
    images = np.random.default_rng(0).integers(0, 256, (6, 2, 48, 160, 3), np.uint8)
    outcomes, users = [], []
    for threads in (1, 2, 5):
        torch.set_num_threads(threads)
        inside: set[tuple[str, int]] = set()

        def forward(batch: np.ndarray, inside: set[tuple[str, int]] = inside) -> np.ndarray:
            inside.add((threading.current_thread().name, torch.get_num_threads()))
            return perceive(model, batch, street.K)[0]

        outcomes.append(np.stack(list(passes(forward, (batch for batch in images)))))
        users.append(inside)
        assert torch.get_num_threads() == threads
    np.testing.assert_array_equal(outcomes[0], outcomes[1])
    np.testing.assert_array_equal(outcomes[0], outcomes[2])
    assert {count for inside in users for _, count in inside} == {1}
    if not torch.cuda.is_available():
        assert len(users[0]) == 1


def test_steer_workers_bounds_the_passes_side_by_side(
    restore_threads: Callable[[int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEER_WORKERS", "1")
    restore_threads(5)
    assert len(set(passes(lambda _: threading.current_thread().name, (number for number in range(9))))) == 1


def test_an_error_in_a_pass_gives_the_threads_back(restore_threads: Callable[[int], None]) -> None:
    torch.set_num_threads(3)

    def fails(batch: int) -> int:
        raise RuntimeError("out of memory")

    with pytest.raises(RuntimeError, match="out of memory"):
        list(passes(fails, (number for number in range(9))))
    assert torch.get_num_threads() == 3
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("prefetch")]


def test_stored_depth_is_rounded_clipped_and_empty_in_the_sky() -> None:
    depth = np.array([1.0, 10.002, 1000.0, 0.0001, 30.0, 0.0])
    cls = np.array([0, 0, 0, 0, classes.SKY, 0])
    assert stored_depth(depth, cls).tolist() == [256, 2561, 65535, 1, 0, 0]
