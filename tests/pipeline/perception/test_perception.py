"""Test passes of the encoder, the cap on the depth of traffic, and ground truth."""

import numpy as np
import pytest
import torch

from pipeline.camera import classes
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.ingest.truth import read_truth
from pipeline.perception.perceive import run_passes
from tests import street

DENSE = "2026_01_01_drive_0001"


def test_passes_give_the_same_bits_for_any_number_of_threads(monkeypatch):
    monkeypatch.setenv("STEER_WORKERS", "5")
    matrices = np.random.default_rng(0).standard_normal((6, 300, 300), np.float32)

    def forward(matrix: np.ndarray) -> np.ndarray:
        assert torch.get_num_threads() == 1
        return (torch.from_numpy(matrix) @ torch.from_numpy(matrix)).sum(0).numpy()

    before = torch.get_num_threads()
    results = []
    for threads in (1, 5):
        torch.set_num_threads(threads)
        batches = (matrix for matrix in matrices)
        results.append(np.stack([*run_passes(forward, batches)]))
        assert torch.get_num_threads() == threads
    torch.set_num_threads(before)
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize("dense", [True, False])
def test_dense_truth_precedes_lidar_which_is_sparse_and_has_no_classes(tmp_path, dense):
    street.write_drive(tmp_path, DENSE, 2, dense=dense, lidar=True)
    _, depth, cls = street.scene(1)
    with open_ingest(tmp_path / f"{DENSE}.h5") as file:
        truth = read_truth(file, read_camera(file), 1)
    if dense:
        assert truth.depth_source == "dense"
        np.testing.assert_array_equal(truth.cls, cls)
    else:
        assert truth.depth_source == "lidar"
        assert (truth.cls == classes.VOID).all()
        hit = np.zeros(street.SIZE, bool)
        hit[::2, ::4] = True
        depth = np.where(hit, depth, 0)
    np.testing.assert_allclose(truth.depth_m, depth, rtol=1e-4, atol=0.5 / 256 + 1e-6)
