import numpy as np
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.camera import classes
from pipeline.encoder.perceive import perceive, stored_depth
from tests import street


def test_batched_equals_single() -> None:
    torch.manual_seed(0)
    model = UnifiedEncoder("small").eval()
    images = np.stack([street.scene(frame)[0] for frame in range(5)])
    depth, cls = perceive(model, images, street.K)
    for i in range(5):
        one_depth, one_cls = perceive(model, images[i : i + 1], street.K)
        np.testing.assert_allclose(one_depth[0], depth[i], rtol=1e-5)
        assert (one_cls[0] != cls[i]).mean() < 1e-3  # a tie may fall either way
    assert depth.dtype == np.float32
    assert cls.dtype == np.uint8
    assert cls.max() < classes.COUNT


def test_stored_depth_is_rounded_clipped_and_empty_in_the_sky() -> None:
    depth = np.array([1.0, 10.002, 1000.0, 0.0001, 30.0])
    cls = np.array([0, 0, 0, 0, classes.SKY])
    assert stored_depth(depth, cls).tolist() == [256, 2561, 65535, 1, 0]
