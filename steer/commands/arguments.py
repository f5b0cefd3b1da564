"""Declare the arguments that several commands share, and take those of a recording."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from footage.settings import Options

if TYPE_CHECKING:
    from steer.outcome import Outcome

SourcePath = Annotated[
    list[Path],
    typer.Argument(metavar="SOURCE...", help="folder of a drive or of images, or videos in order"),
]
Out = Annotated[
    Path | None, typer.Option(help="new or empty folder for the results; default: out/SOURCE")
]
Video = Annotated[bool, typer.Option(help="write overlay.mp4")]


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of a recording in place of the parameter ``**options``."""
    signature = inspect.signature(command)
    *parameters, _ = signature.parameters.values()  # without **options
    for name, field in Options.model_fields.items():
        flag = f"--{(field.alias or name).replace('_', '-')}"
        metavar = field.examples[0] if field.examples else None
        option = typer.Option(flag, help=field.description, metavar=metavar)
        annotation: Any = Annotated[field.annotation, option]
        kind = inspect.Parameter.KEYWORD_ONLY
        parameters.append(
            inspect.Parameter(name, kind, default=field.default, annotation=annotation)
        )
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return command


def run_command(
    function: Callable[..., "Outcome"], source: list[Path], out: Path | None, **options: Any
) -> None:
    """Call a function of `steer.api` with a free folder. Print notes, files and doubts."""
    from pipeline.jobs.outputs import free_folder

    with free_folder(out, source[0].resolve().stem.removesuffix("_sync")) as folder:
        outcome = function(source, out=folder, **options)
    files = ", ".join(str(path) for path in outcome.files)
    print(*outcome.notes, files, sep="\n")
    for text in outcome.doubts:
        print(f"doubt: {text}")
