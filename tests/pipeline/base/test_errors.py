"""Errors with fields: rendering, context, pickling."""

import pickle

import pytest

from pipeline.base.errors import DamagedFile, InputError, closest, error_context


@pytest.mark.parametrize(
    ("where", "fix", "message"),
    [
        ("", "", "no end"),
        ("", "Do b", "no end. Do b"),
        ("a", "", "a: no end"),
        ("a", "Do b", "a: no end. Do b"),
    ],
)
def test_rendering(where: str, fix: str, message: str) -> None:
    error = InputError("no end", where, fix)
    assert str(error) == message
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), copy.problem, copy.where, copy.fix) == (InputError, message, "no end", where, fix)


@pytest.mark.parametrize("error", [InputError("cut short", "b"), ValueError("cut short"), DamagedFile("cut short")])
def test_context_adds_where_and_fix(error: Exception) -> None:
    with pytest.raises(InputError) as raised, error_context("a", "Extract it again"):
        raise error
    inner = ": b" if isinstance(error, InputError) and error.where else ""
    assert str(raised.value) == f"a{inner}: cut short. Extract it again"
    assert type(raised.value) is (DamagedFile if isinstance(error, DamagedFile) else InputError)
    assert raised.value.__cause__ is error


def test_closest_names() -> None:
    assert closest("gn", ["gnn", "pointnet2"]) == "did you mean gnn?"
    assert closest("xyz", ["gnn", "pointnet2"]) == "known: gnn, pointnet2"
    assert closest("xyz", []) == "known: none"
