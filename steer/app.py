"""The command `steer`. Large imports are inside functions, so that help is quick."""

from collections.abc import Callable

import typer

from pipeline.base.console import guarded
from steer import artefacts, doctor, import_recording, measure, predict

app = typer.Typer(
    help="Measure motion, predict steering angles with a trained model, import recordings, and inspect data.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,  # rich's help takes twice the time
)


def _add(name: str, command: Callable[..., object], after_stop: str, needs_arguments: bool = True) -> None:
    app.command(name, no_args_is_help=needs_arguments)(guarded(command, after_stop))


_add("predict", predict.predict, "the frames so far are in .unfinished of the output folder")
_add("measure", measure.measure, "the frames so far are in .unfinished of the output folder")
_add("import", import_recording.import_recording, "no drive was written, repeat the command")
_add("show", artefacts.show, "files that were written are complete")
_add("diff", artefacts.diff, "nothing was written")
_add("doctor", doctor.doctor, "nothing was written", needs_arguments=False)
_add("export", artefacts.export, "nothing was written")

if __name__ == "__main__":
    app(prog_name="steer")
