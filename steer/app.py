"""The command `steer`. Large imports are inside functions, so that help is quick."""

from collections.abc import Callable

from pipeline.base.console import App, guarded
from steer import import_, measure, predict, show

app = App(
    help="Measure motion, predict steering angles with a trained model, import recordings, and inspect data.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,  # rich's help takes twice the time
)


def _add(name: str, command: Callable[..., object], after_stop: str, help: str | None = None) -> None:
    app.command(name, no_args_is_help=True, help=help)(guarded(command, after_stop))


_UNFINISHED = "Repeat the command to continue"
_NO_DRIVE = "No drive was written; repeat the command"
_add("predict", predict.predict, _UNFINISHED, help=predict.__doc__)
_add("measure", measure.measure, _UNFINISHED, help=measure.__doc__)
_add("import", import_.import_recording, _NO_DRIVE, help=import_.__doc__)
_add("show", show.show, "Nothing was written")

if __name__ == "__main__":
    app(prog_name="steer")
