"""The command `steer`: a module for each of its verbs. They import what is large in their functions: help is quick."""

from collections.abc import Callable

import typer

from pipeline.base.console import guarded
from steer import diff, doctor, export, import_recording, predict, show

app = typer.Typer(
    help="Steering angles from a trained model, your own recordings as KITTI raw, and what an artefact holds.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="markdown",
)


def _add(name: str, command: Callable[..., object], kept: str, needs_arguments: bool = True) -> None:
    app.command(name, no_args_is_help=needs_arguments)(guarded(command, kept))


_add("predict", predict.predict, "the frames so far are in .unfinished of the output folder")
_add("import", import_recording.import_recording, "no drive is written; run the same command again")
_add("show", show.show, "what is written is whole")
_add("diff", diff.diff, "nothing is written")
_add("doctor", doctor.doctor, "nothing is written", needs_arguments=False)
_add("export", export.export, "nothing is written")
