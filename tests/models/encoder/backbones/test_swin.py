from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor
from transformers import SwinConfig, SwinForImageClassification

from models.encoder.backbones.swin import CHANNELS, WINDOW
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.encoder.weights import fill
from pipeline.sections.encoder import Weights

State = dict[str, Tensor]


@pytest.fixture(scope="module")
def classifier() -> SwinForImageClassification:
    torch.manual_seed(0)
    return SwinForImageClassification(SwinConfig(initializer_range=0.1)).eval()  # the defaults are Swin-T


@pytest.fixture(scope="module")
def published(classifier: SwinForImageClassification, tmp_path_factory: pytest.TempPathFactory) -> State:
    """Tensors as the library writes them, and the index that files of version 4 have beside them."""
    folder = tmp_path_factory.mktemp("published")
    classifier.save_pretrained(folder)
    state: State = load_file(folder / "model.safetensors")
    tables = [name for name in state if name.endswith(".attention.self.relative_position_bias_table")]
    assert len(tables) == 12, "not the names of published files"
    index = torch.zeros(WINDOW**2, WINDOW**2, dtype=torch.int64)
    return state | {name.replace("bias_table", "index"): index for name in tables}


@pytest.mark.slow
def test_a_published_classifier_fills_the_backbone_and_gives_the_same_features(
    classifier: SwinForImageClassification, published: State, tmp_path: Path
) -> None:
    torch.save(published, tmp_path / "pytorch_model.bin")
    model = UnifiedEncoder("swin-t").eval()
    fill(model, "swin-t", Weights.model_validate({"backbone": str(tmp_path / "pytorch_model.bin")}))
    image = torch.rand(1, 3, 448, 448)  # on smaller maps a classifier shifts no windows
    with torch.no_grad():
        maps = model.backbone(image, torch.zeros(1, 2, 448, 448))
        last = classifier.swin(image).last_hidden_state
    assert [tuple(one.shape[1:]) for one in maps] == [(c, 112 >> i, 112 >> i) for i, c in enumerate(CHANNELS)]
    norm = classifier.swin.layernorm
    torch.testing.assert_close(norm(maps[-1].flatten(2).mT), last, rtol=1e-5, atol=1e-5)
