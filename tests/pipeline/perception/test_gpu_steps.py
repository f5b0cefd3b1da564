"""The encoder's fit and perception on a simulated GPU: devices, blocking copies and synchronisations."""

from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.camera.camera import Camera
from pipeline.fitting import checkpoint
from pipeline.perception.examples import Examples
from pipeline.perception.fit import fit
from pipeline.perception.perceive import perceive
from tests import simulated_gpu, street

DRIVE, SIZE = "2026_01_01_drive_0001", (56, 140)
K = np.array([[60.0, 0, 69.5], [0, 60.0, 27.5], [0, 0, 1]])
STEPS = 2
LIMITS = {
    **{"small": 100, "espnetv2": 460, "espnetv2-s1": 460, "dinov2-vits14": 350},
    **{"swin-t": 560, "rtmonodepth-s": 480, "street": 80},
}
FIT_LIMITS = {
    **{"small": 260, "espnetv2": 1090, "espnetv2-s1": 1090, "dinov2-vits14": 920},
    **{"swin-t": 1150, "rtmonodepth-s": 1130, "street": 170},
}


@pytest.mark.parametrize("backbone", LIMITS)
def test_perception_waits_only_for_its_results(backbone: str) -> None:
    torch.manual_seed(0)
    model = UnifiedEncoder(backbone).eval()
    images = np.random.default_rng(0).integers(0, 256, (2, *SIZE, 3), np.uint8)
    expected = perceive(model, images, Camera(K, SIZE))
    with simulated_gpu.Gpu() as gpu:
        gpu.move(model)
        depth, cls = perceive(model, images, Camera(K, SIZE))
    assert gpu.launches <= LIMITS[backbone]
    assert not gpu.copies
    assert len(gpu.synchronisations) == 2  # depth and classes
    np.testing.assert_allclose(depth, expected[0], rtol=1e-4)
    assert (cls == expected[1]).mean() > 0.999


@pytest.mark.parametrize("backbone", FIT_LIMITS)
def test_a_step_of_the_fit_does_not_wait(tmp_path: Path, backbone: str) -> None:
    street.write_drive(tmp_path, DRIVE, STEPS)
    torch.manual_seed(0)
    model = UnifiedEncoder(backbone)
    counts: list[tuple[int, int, int]] = []  # after each epoch

    def record(*_: object) -> None:
        counts.append((len(gpu.copies), len(gpu.synchronisations), gpu.launches))

    with (
        Examples(tmp_path, [DRIVE], STEPS) as examples,
        simulated_gpu.Gpu() as gpu,
        mock.patch.object(checkpoint, "write", record),
    ):
        gpu.move(model)
        fit(model, examples, epochs=2, batch=1, learning_rate=0.003, seed=0, state_path=tmp_path / "state.pt")
    (copies, waits, launches), (copies_2, waits_2, launches_2) = counts
    assert copies == copies_2 == 0
    assert (waits, waits_2) == (1, 2)  # the losses of each epoch
    assert launches_2 - launches <= STEPS * FIT_LIMITS[backbone]
