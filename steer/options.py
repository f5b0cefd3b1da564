"""The options that all commands share, and how a command says what it found."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import typer

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="say nothing but errors")]
Json = Annotated[bool, typer.Option("--json", help="say the result as one JSON object, and nothing else")]
Debug = Annotated[bool, typer.Option("--debug", help="show the whole trace of an error")]


@dataclass(frozen=True)
class Voice:
    """How much a command says on its standard output."""

    quiet: bool = False
    json: bool = False

    @property
    def talks(self) -> bool:
        """Whether people read along: lines, progress bars."""
        return not (self.quiet or self.json)

    def line(self, text: str) -> None:
        """Say a line to people."""
        if self.talks:
            print(text, flush=True)

    def result(self, content: Mapping[str, Any]) -> None:
        """Say the result to machines, if they are asked for; what is not finite is null."""
        if self.json:
            print(json.dumps(_plain(content), indent=1, allow_nan=False), flush=True)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), -float("inf"))):
        return None
    return value
