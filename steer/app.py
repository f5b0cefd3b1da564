"""The command `steer`. Large imports are inside functions, so that help is quick."""

import typer

from pipeline.base.console import guarded
from steer import import_, measure, perceive, predict, show

app = typer.Typer(
    help="Measure motion, predict steering angles with a trained model, import recordings, and inspect data.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,  # rich's help takes twice the time
)


app.command("predict", no_args_is_help=True, help=predict.__doc__)(guarded(predict.predict))
app.command("measure", no_args_is_help=True, help=measure.__doc__)(guarded(measure.measure))
app.command("perceive", no_args_is_help=True, help=perceive.__doc__)(guarded(perceive.perceive))
app.command("import", no_args_is_help=True, help=import_.__doc__)(guarded(import_.import_recording))
app.command("show", no_args_is_help=True)(guarded(show.show))

if __name__ == "__main__":
    app(prog_name="steer")
