import hashlib
import pickle
from pathlib import Path

import pytest
import torch

from models.unified_encoder import UnifiedEncoder
from pipeline.errors import InputError
from pipeline.weights import find_weights, load_weights, read_weights, write_weights

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
    load_weights(model, weights, MEND)
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


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_read_refuses_a_file_cut_short(checkpoint: Path, share: float) -> None:
    content = checkpoint.read_bytes()
    checkpoint.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"encoder\.pt is cut short, or no checkpoint .* Mend it so\."):
        read_weights(checkpoint, MEND)


class _Evil:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (Path.touch, (Path("harmed"),))  # type: ignore[return-value]


def test_read_runs_no_code_and_refuses_other_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.pt").write_bytes(pickle.dumps(_Evil()))
    with pytest.raises(InputError, match="holds tensors alone"):
        read_weights(tmp_path / "evil.pt", MEND)
    assert not (tmp_path / "harmed").exists()
    torch.save({"conv.weight": torch.zeros(3)}, tmp_path / "other.pt")
    with pytest.raises(InputError, match="no checkpoint of this project's unified encoder"):
        read_weights(tmp_path / "other.pt", MEND)
    with pytest.raises(InputError, match=r"none\.pt is missing\. Mend it so\."):
        read_weights(tmp_path / "none.pt", MEND)


def test_load_names_the_first_tensor_that_does_not_fit(checkpoint: Path) -> None:
    model = UnifiedEncoder("small")
    state = dict(read_weights(checkpoint, MEND).state)
    faults = {
        r"lacks class_head\.bias": {k: v for k, v in state.items() if k != "class_head.bias"},
        r"has extra, which the network has not": {**state, "extra": torch.zeros(1)},
        r"has class_head\.bias of shape \[9\], the network \[76\]": {**state, "class_head.bias": torch.zeros(9)},
    }
    for message, other in faults.items():
        write_weights(checkpoint, "small", other)
        with pytest.raises(InputError, match=message):
            load_weights(model, read_weights(checkpoint, MEND), MEND)
