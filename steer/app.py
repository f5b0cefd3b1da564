"""Define the command `steer`, and its verbs `street`, `show`, `view` and `export`.

Large imports are inside functions, so that help is quick.
"""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from pipeline.jobs.console import guarded

from pipeline.base.errors import InputError
from steer.commands import import_, measure, predict
from steer.commands.arguments import with_options

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,  # help by rich takes twice the time
)


def _print_version(requested: bool) -> None:
    """Print the version and exit, if --version is given."""
    if requested:
        from pipeline.jobs.revision import revision

        from pipeline.base.checkout import ROOT

        # An installed wheel has no revision.
        print(f"steer {version('semantic-steering')} {revision(ROOT)}".rstrip())
        raise typer.Exit


@app.callback()
def steer(
    _: Annotated[bool, typer.Option("--version", callback=_print_version, is_eager=True)] = False,
) -> None:
    """Measure motion, predict angles with a trained model, import recordings, and use data."""


def street() -> None:
    """Make the encoder of real streets, which `steer measure` uses by default.

    Its two networks have published weights, which are downloaded once: 8 MB, for non-commercial use
    only. In a checkout, they and the encoder lie in weights/, otherwise in the user's cache.
    """
    from steer import street_encoder

    for source in street_encoder.make_encoder():
        print(source)
    print(street_encoder.encoder_folder())


def show(
    path: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="a drive's .h5 file of any stage, or a checkpoint"),
    ],
) -> None:
    """Print a file's attributes, datasets and settings.

    \b
    steer show data/graphs/semantic/2026_06_01_drive_0004.h5
    steer show data/train/sa-gnn-ncp/best.pt
    """
    import yaml

    from steer import artefact

    content = artefact.describe_file(path)
    text = yaml.safe_dump(
        content, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110
    )
    print(text.rstrip())


def view(
    path: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="a drive's .h5 file of data/clouds or data/graphs"),
    ],
    frame: Annotated[
        int | None, typer.Option(min=0, help="number of the frame; default: the middle one")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="HTML", help="new file; default: out/DRIVE.html")
    ] = None,
) -> None:
    """Write a frame of a point cloud or graph in 3D as a page, to open in a browser.

    Points far from the car are left out. Of many points and edges, only some are shown.

    \b
    steer view data/graphs/semantic/2026_06_01_drive_0004.h5
    steer view data/graphs/semantic/2026_06_01_drive_0004.h5 --frame 7 --out graph.html
    """
    from pipeline.jobs.outputs import find_free

    from steer import artefact

    if out and out.suffix != ".html":
        raise InputError("expected the name of an HTML file", "--out")
    page = find_free(out, path.stem, ".html")
    artefact.write_view(path, frame, page)
    print(page)


def export(
    path: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="a drive's .h5 file of data/clouds or data/graphs"),
    ],
    out: Annotated[Path, typer.Argument(metavar="CLOUD", help="new .ply or .pcd file")],
    frame: Annotated[int, typer.Option(min=0, help="number of the frame")],
) -> None:
    """Write the points of a frame as PLY or PCD, which Open3D, CloudCompare and others read.

    Each point has x, y and z in metres, its class, the further columns of the file, and the colour
    of its pixel if the frame's image is in data/ingest.

    \b
    steer export data/clouds/pseudo/2026_06_01_drive_0004.h5 --frame 7 cloud.ply
    steer export data/graphs/semantic/2026_06_01_drive_0004.h5 --frame 7 graph.pcd
    """
    from steer import export as exporting

    print(f"{out}: {exporting.export_points(path, frame, out)}")


COMMANDS = {
    "predict": (predict, with_options(predict.predict)),
    "measure": (measure, with_options(measure.measure)),
    "import": (import_, with_options(import_.import_recording)),
}
for name, (module, command) in COMMANDS.items():
    app.command(name, no_args_is_help=True, help=module.__doc__)(guarded(command))
app.command("street")(guarded(street))
app.command("show", no_args_is_help=True)(guarded(show))
app.command("view", no_args_is_help=True)(guarded(view))
app.command("export", no_args_is_help=True)(guarded(export))


def main() -> None:
    """Run the command `steer`."""
    app(prog_name="steer")


if __name__ == "__main__":
    main()
