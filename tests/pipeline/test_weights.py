import hashlib
from pathlib import Path

import pytest
import torch

from models.unified_encoder import UnifiedEncoder
from pipeline.checkpoint import load_state
from pipeline.errors import InputError
from pipeline.weights import find_weights, read_weights, write_weights

MEND = "Mend it so."


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    torch.manual_seed(1)
    write_weights(tmp_path / "encoder.pt", "small", UnifiedEncoder("small").state_dict())
    return tmp_path / "encoder.pt"


def test_written_weights_come_back_bit_by_bit_and_the_file_is_deterministic(checkpoint: Path, tmp_path: Path) -> None:
    weights = read_weights(checkpoint, MEND)
    assert weights.backbone == "small"
    model = UnifiedEncoder("small")
    load_state(model, weights.state, checkpoint, MEND)
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, weights.state[name]), name
    (tmp_path / "other").mkdir()
    write_weights(tmp_path / "other" / "encoder.pt", "small", model.state_dict())
    assert (tmp_path / "other" / "encoder.pt").read_bytes() == checkpoint.read_bytes()


def test_find_accepts_a_path_with_or_without_its_hash(checkpoint: Path) -> None:
    sha256 = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    assert find_weights(str(checkpoint)) == (checkpoint, sha256)
    assert find_weights(f"{checkpoint}#sha256={sha256.upper()}") == (checkpoint, sha256)


def test_find_refuses_a_missing_file_another_hash_and_no_hash(checkpoint: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.pt is missing\. Put the checkpoint there"):
        find_weights("nowhere.pt")
    with pytest.raises(InputError, match=r"has the SHA-256 [0-9a-f]{64}, not 0{64}"):
        find_weights(f"{checkpoint}#sha256={'0' * 64}")
    with pytest.raises(InputError, match="64 hexadecimal digits"):
        find_weights(f"{checkpoint}#sha256=abc")


def test_read_refuses_other_content(checkpoint: Path, tmp_path: Path) -> None:
    content = checkpoint.read_bytes()
    checkpoint.write_bytes(content[: len(content) // 3])
    with pytest.raises(InputError, match=r"encoder\.pt is cut short, .* Mend it so\."):
        read_weights(checkpoint, MEND)
    torch.save({"conv.weight": torch.zeros(3)}, tmp_path / "other.pt")
    with pytest.raises(InputError, match="no checkpoint of this project's unified encoder"):
        read_weights(tmp_path / "other.pt", MEND)
