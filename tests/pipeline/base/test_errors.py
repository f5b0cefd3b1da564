"""What a user is meant to read says where, what, and what to do."""

import pytest

from pipeline.base.errors import DamagedFile, InputError, closest, error_context


def test_explained_adds_where_and_a_hint() -> None:
    for error in (InputError("is cut short"), ValueError("is cut short")):
        with pytest.raises(InputError) as raised, error_context("a.png", fix="Extract it again"):
            raise error
        assert str(raised.value) == "a.png: is cut short. Extract it again"
        assert type(raised.value) is InputError
        assert raised.value.__cause__ is error


@pytest.mark.parametrize(
    ("where", "hint", "message"),
    [("", "", "no end."), ("", "do b", "no end. do b"), ("a", "", "a: no end."), ("a", "do b", "a: no end. do b")],
)
def test_parts_that_are_left_out(where: str, hint: str, message: str) -> None:
    with pytest.raises(InputError) as raised, error_context(where, fix=hint):
        raise InputError("no end.")
    assert str(raised.value) == message


def test_a_damaged_file_stays_one() -> None:
    with pytest.raises(DamagedFile, match=r"a: is cut\. Extract"), error_context("a", fix="Extract"):
        raise DamagedFile("is cut")


def test_other_errors_pass() -> None:
    for error in (KeyError("a"), OSError("b"), KeyboardInterrupt()):
        with pytest.raises(type(error)) as raised, error_context("where", fix="hint"):
            raise error
        assert raised.value is error


def test_an_input_error_is_not_caught_as_a_mistake_in_the_program() -> None:
    assert not issubclass(InputError, ValueError)


def test_closest_names() -> None:
    assert closest("gn", ["gnn", "pointnet2"]) == "did you mean gnn?"
    assert closest("xyz", ["gnn", "pointnet2"]) == "known: gnn, pointnet2"
    assert closest("xyz", []) == "known: none"
