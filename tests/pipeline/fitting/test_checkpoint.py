import errno
from pathlib import Path

import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.fitting import checkpoint


def test_read_gives_what_write_got(tmp_path: Path) -> None:
    checkpoint.write(tmp_path / "a" / "x.pt", {"kind": "thing", "net": {"w": torch.arange(3.0)}, "epoch": 2})
    content = checkpoint.read(tmp_path / "a" / "x.pt", "thing")
    assert content["epoch"] == 2
    assert content["net"]["w"].tolist() == [0, 1, 2]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["x.pt"]


def test_bad_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.pt"
    with pytest.raises(InputError, match=r"x\.pt is missing"):
        checkpoint.read(path, "thing")
    checkpoint.write(path, {"kind": "thing"})
    with pytest.raises(InputError, match=r"not a checkpoint of .* other"):
        checkpoint.read(path, "other")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="cut short"):
        checkpoint.read(path, "thing")


def test_no_flipped_bit_gets_into_a_network(tmp_path: Path) -> None:
    path = tmp_path / "x.pt"
    weight = torch.linspace(-1, 1, 500)
    checkpoint.write(path, {"kind": "thing", "net": {"weight": weight}})
    whole = path.read_bytes()
    start = whole.index(weight.numpy().tobytes())
    said = []
    for place in [*range(start, start + 2000, 97), *range(0, len(whole), 41)]:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :])
        try:
            content = checkpoint.read(path, "thing")
        except InputError as error:
            said.append(str(error))
            continue
        assert not start <= place < start + 2000  # a byte that means nothing, as padding
        assert torch.equal(content["net"]["weight"], weight)
    assert len(said) > 20
    assert all(line.startswith(str(path)) for line in said)


def test_what_the_system_refuses_is_not_called_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint.write(tmp_path / "x.pt", {"kind": "thing"})

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", "x.pt")

    monkeypatch.setattr(torch, "load", refuse)
    with pytest.raises(PermissionError):
        checkpoint.read(tmp_path / "x.pt", "thing")


def test_nothing_in_a_file_is_run(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (open, (str(tmp_path / "sprung"),))

    torch.save({"kind": "thing", "trap": Trap()}, tmp_path / "x.pt")
    with pytest.raises(InputError, match="more than tensors"):
        checkpoint.read(tmp_path / "x.pt", "thing")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda state: state.pop("bias"), "it lacks bias"),
        (lambda state: state.update(extra=torch.zeros(1)), "it has extra, which the network lacks"),
        (
            lambda state: state.update(weight=torch.zeros(2, 9)),
            r"it has weight of shape \[2, 9\], the network \[2, 3\]",
        ),
        (lambda state: state["bias"].fill_(torch.nan), "it has numbers in bias that are not finite"),
    ],
)
def test_state_must_fit_exactly(change: object, fault: str) -> None:
    net = torch.nn.Linear(3, 2)
    state = {name: tensor + 1 for name, tensor in net.state_dict().items()}
    before = net.weight.detach().clone()
    checkpoint.load_state(torch.nn.Linear(3, 2), state, Path("x.pt"))
    change(state)  # type: ignore[operator]
    with pytest.raises(InputError, match=fault):
        checkpoint.load_state(net, state, Path("x.pt"))
    assert torch.equal(net.weight, before)


def test_content_that_was_read_is_written_as_what_was_made(tmp_path: Path) -> None:
    net = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.Linear(2, 1))
    optimiser = torch.optim.AdamW(
        [{"params": [parameter], "weight_decay": 0.1} for parameter in net.parameters()], lr=0.1
    )
    net(torch.ones(1, 3)).sum().backward()
    optimiser.step()
    content = {"kind": "thing", "lr": 0.1, "weight_decay": [("lr", None)], "optimiser": optimiser.state_dict()}
    checkpoint.write(tmp_path / "made.pt", content)
    read = checkpoint.read(tmp_path / "made.pt", "thing")
    optimiser.load_state_dict(read["optimiser"])
    checkpoint.write(tmp_path / "read.pt", {**read, "optimiser": optimiser.state_dict()})
    checkpoint.write(tmp_path / "mixed.pt", {**content, "optimiser": optimiser.state_dict()})
    made, *others = (path.read_bytes() for path in sorted(tmp_path.iterdir()))
    assert [other == made for other in others] == [True, True]
