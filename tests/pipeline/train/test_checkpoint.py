from pathlib import Path
from typing import Any

import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.train import checkpoint


class Trap:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return (open, (str(self.path), "w"))


def test_code_in_a_file_does_not_run(tmp_path: Path) -> None:
    torch.save({"kind": "thing", "trap": Trap(tmp_path / "sprung")}, tmp_path / "x.pt")
    with pytest.raises(InputError, match="more than tensors"):
        checkpoint.read(tmp_path / "x.pt", "thing")
    assert not (tmp_path / "sprung").exists()


def test_missing_damaged_and_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a/x.pt"
    with pytest.raises(InputError, match="missing"):
        checkpoint.read(path, "thing")
    checkpoint.write(path, {"kind": "thing", "net": {"weight": torch.linspace(-1, 1, 500)}})
    assert torch.equal(checkpoint.read(path, "thing")["net"]["weight"], torch.linspace(-1, 1, 500))
    with pytest.raises(InputError, match=r"expected a checkpoint of .* other"):
        checkpoint.read(path, "other")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="damaged"):
        checkpoint.read(path, "thing")


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"bias": None}, r'Missing key\(s\) in state_dict: "bias"'),
        ({"extra": torch.zeros(1)}, r'Unexpected key\(s\) in state_dict: "extra"'),
        ({"weight": torch.zeros(2, 9)}, r"size mismatch for weight: .*\[2, 9\]"),
        ({"bias": torch.full((2,), torch.nan)}, "bias has numbers that are not finite"),
        ({"bias": "two"}, "tensors by name"),
    ],
)
def test_a_state_must_match_exactly(change: dict[Any, object], fault: str) -> None:
    net = torch.nn.Linear(3, 2)
    state = {name: tensor + 1 for name, tensor in net.state_dict().items()}
    checkpoint.load_state(torch.nn.Linear(3, 2), state, Path("x.pt"))
    changed = {name: value for name, value in {**state, **change}.items() if value is not None}
    with pytest.raises(InputError, match=fault) as raised:
        checkpoint.load_state(net, changed, Path("x.pt"))
    assert "\n" not in str(raised.value)


def test_content_from_a_file_is_written_with_the_same_bytes(tmp_path: Path) -> None:
    net = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.Linear(2, 1))
    optimiser = torch.optim.AdamW([{"params": [p], "weight_decay": 0.1} for p in net.parameters()], lr=0.1)
    net(torch.ones(1, 3)).sum().backward()
    optimiser.step()
    content = {"kind": "thing", "lr": 0.1, "weight_decay": [("lr", None)], "optimiser": optimiser.state_dict()}
    checkpoint.write(tmp_path / "new.pt", content)
    read = checkpoint.read(tmp_path / "new.pt", "thing")
    optimiser.load_state_dict(read["optimiser"])
    checkpoint.write(tmp_path / "again.pt", {**read, "optimiser": optimiser.state_dict()})
    checkpoint.write(tmp_path / "mixed.pt", {**content, "optimiser": optimiser.state_dict()})
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1
