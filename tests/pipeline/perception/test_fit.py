from collections.abc import Iterator

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.perception.examples import Examples
from pipeline.perception.fit import depth_and_class_loss, fit
from tests import street

DRIVE = "2026_01_01_drive_0001"


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Examples]:
    folder = tmp_path_factory.mktemp("ingest")
    street.write_drive(folder, DRIVE, 6)
    with Examples(folder, [DRIVE], 6) as examples:
        yield examples


def test_a_fit_lowers_both_losses(examples: Examples) -> None:
    torch.manual_seed(0)
    model = UnifiedEncoder("small")
    curve = fit(model, examples, epochs=4, batch=3, learning_rate=0.003, seed=0)
    assert curve[-1].depth < 0.9 * curve[0].depth
    assert curve[-1].classes < 0.9 * curve[0].classes
    assert [row.epoch for row in curve] == [1, 2, 3, 4]


def test_the_loss_ignores_unknown_pixels_and_matches_hand_values() -> None:
    depth = torch.tensor([[[2.0, 8.0, 5.0]]])
    true_depth = torch.tensor([[[4.0, 8.0, 0.0]]])
    logits = torch.zeros(1, 19, 1, 3)
    logits[0, 3, 0, 0] = 50.0
    true_cls = torch.tensor([[[3, 255, 7]]])
    loss = depth_and_class_loss(depth, logits, true_depth, true_cls)
    np.testing.assert_allclose(loss, [(np.log(2) / 2 + 0.5 / 2) / 2, np.log(19) / 2], rtol=1e-5)
