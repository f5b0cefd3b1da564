"""Give commands the options that settings declare, so that each option is declared once."""

import inspect
from collections.abc import Callable, Collection
from typing import Annotated, Any, get_args

import typer
from annotated_types import Ge, Le
from pydantic import Field
from pydantic.fields import FieldInfo

from pipeline.base.params import Section
from pipeline.ingest.settings import RecordingOptions
from pipeline.labels.settings import Wheelbase


class MeasureOptions(RecordingOptions):
    """Options of a recording, and the car's wheelbase.

    For a prediction, the wheelbase is that of the trained model.
    """

    wheelbase_m: Wheelbase = Field(
        default=2.7, alias="wheelbase", description="distance between the axles, metres"
    )


def with_options(
    command: Callable[..., None], kind: type[Section], *, repeated: Collection[str] = ()
) -> Callable[..., None]:
    """Return a command with the fields of `kind` that have a description as its options.

    They replace the parameter ``**options``. An option whose name is in `repeated` may be passed
    several times.
    """
    signature = inspect.signature(command)
    *parameters, _ = signature.parameters.values()  # without **options
    for name, field in kind.model_fields.items():
        if field.description:
            parameters.append(_parameter(name, field, repeated=name in repeated))
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return command


def _parameter(name: str, field: FieldInfo, *, repeated: bool) -> inspect.Parameter:
    """Return a field as a parameter with the limits and the help of its declaration."""
    limits: dict[str, Any] = {}
    for limit in field.metadata:
        if isinstance(limit, Ge):
            limits["min"] = limit.ge
        if isinstance(limit, Le):
            limits["max"] = limit.le
    annotation: Any = field.annotation
    if len(get_args(annotation)) > 2:
        # Typer takes no unions, so the field's validator gets the text.
        annotation = str | None
    text = field.description
    if repeated:
        annotation = list[get_args(annotation)[0]] | None  # type: ignore[misc]
        text = f"{text}; with --each, one per recording"
    key = field.alias or name
    flag = f"--{key.replace('_', '-')}"
    metavar = field.examples[0] if field.examples else None
    option = typer.Option(flag, help=text, metavar=metavar, **limits)
    annotation = Annotated[annotation, option]
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=field.default, annotation=annotation)
