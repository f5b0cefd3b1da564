"""Write the tables of settings into the pages, from the classes that declare the settings.

    python -m docs.make_settings

A table stands between a comment with the name of a section of params.yaml, as in
<!-- settings: train -->, and the comment <!-- end -->. The table `networks` has the options of the
networks. A key has a row with the default, the values and the description of its field. If
params.yaml sets a key of a section, the default is the value there.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.jobs import console

from models.steering.core.options import load_options, network_names
from pipeline.base import store
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.params import read_yaml
from pipeline.check.settings import Params

# JSON schema of a section, of an entry, of a network's options, or of a key.
Schema = Mapping[str, Any]

PAGES = (ROOT / "data/README.md", ROOT / "docs/models.md", ROOT / "docs/running.md")
# A table in a page. The comment before it has its name.
TABLE = re.compile(r"(<!-- settings: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
# Largest number of characters of a default that is shown. Lists of drives are longer.
DEFAULT_WIDTH = 40
# Bound of a number in a JSON schema → its sign.
SIGNS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


class Row(NamedTuple):
    """A key and the texts of its row."""

    key: str
    default: str
    values: str
    meaning: str


def render() -> None:
    """Write the tables into the pages."""
    for page, content in pages().items():
        store.write_text(page, content)


def pages() -> dict[Path, str]:
    """Return the path and the text of each page, with the tables of the present settings.

    Raises InputError if a key has no description, or if there is no table of a comment's name.
    """
    tables = {**section_tables(), "networks": networks_table()}

    def table(match: re.Match[str]) -> str:
        start, name, end = match.groups()
        if name not in tables:
            raise InputError(f"settings: {name}: {closest(name, [*tables])}")
        return start + tables[name] + end

    texts = {}
    for page in PAGES:
        with error_context(page):
            texts[page] = TABLE.sub(table, page.read_text(encoding="utf-8"))
    return texts


def section_tables() -> dict[str, str]:
    """Return section → table of its keys, or if it has entries, of the keys of an entry."""
    params = read_yaml(ROOT / "params.yaml")
    schema = Params.model_json_schema()
    tables = {}
    for name, section in schema["properties"].items():
        entries = section.get("additionalProperties")
        kind = find_definition(schema, entries or section)
        values = {} if entries else params[name]
        with error_context(f"section {name}"):
            rows = list(describe_keys(schema, kind, values))
        tables[name] = to_markdown(Row._fields, rows)
    return tables


def networks_table() -> str:
    """Return the table of the networks' options. Networks that share a row are named there."""
    networks: dict[Row, list[str]] = {}
    for part in ("spatial", "temporal"):
        for name in network_names(part):
            schema = load_options(part, name).model_json_schema()
            with error_context(f"models/steering/{part}/{name}.py"):
                for row in describe_keys(schema, schema, {}):
                    networks.setdefault(row, []).append(f"`{name}`")
    heads = ("key", "network", *Row._fields[1:])
    rows = [(row.key, ", ".join(names), *row[1:]) for row, names in networks.items()]
    return to_markdown(heads, rows)


def describe_keys(
    schema: Schema, kind: Schema, values: Mapping[str, Any], prefix: str = ""
) -> Iterator[Row]:
    """Yield a row for each key of `kind`, and for the keys below it.

    `schema` has the definitions of the keys below a key. `values` go before the defaults. Raises
    InputError for a key without a description.
    """
    for name, field in kind["properties"].items():
        if "$ref" in field:
            group = find_definition(schema, field)
            yield from describe_keys(schema, group, values.get(name, {}), f"{prefix}{name}.")
            continue
        if "description" not in field:
            fix = 'Declare it with Field(description="…"): what it is, with its unit'
            raise InputError(f"{prefix}{name} has no description", fix=fix)
        default = "required"
        if name in values or "default" in field:
            default = default_text(values.get(name, field.get("default")))
        yield Row(f"`{prefix}{name}`", default, values_text(field), field["description"])


def find_definition(schema: Schema, field: Schema) -> Schema:
    """Return the JSON schema of the class to which a field refers."""
    definition: Schema = schema["$defs"][field["$ref"].rpartition("/")[2]]
    return definition


def default_text(value: Any) -> str:
    text = to_yaml(value)
    return text if len(text) <= DEFAULT_WIDTH else "see params.yaml"


def values_text(field: Schema) -> str:
    """Return the values that the type and the limits of a key allow."""
    if "enum" in field:
        return ", ".join(to_yaml(value) for value in field["enum"])
    if "const" in field:
        return to_yaml(field["const"])
    if "anyOf" in field:
        return ", ".join(values_text(choice) for choice in field["anyOf"])
    match field.get("type"):
        case "null":
            return to_yaml(None)
        case "boolean":
            return f"{to_yaml(True)}, {to_yaml(False)}"
        case "integer" | "number":
            limits = [f"{sign} {field[key]}" for key, sign in SIGNS.items() if key in field]
            return " ".join([field["type"], " and ".join(limits)]).strip()
        case "string":
            return str(field.get("format", "text"))
        case "array":
            return list_text(field)
        case "object" if "propertyNames" in field:
            names = values_text(field["propertyNames"])
            return f"mapping of {names} to {values_text(field['additionalProperties'])}"
    return "mapping" if field.get("type") == "object" else "any"


def list_text(field: Schema) -> str:
    """Return the length of a list and the values of its items."""
    least = field.get("minItems", 0)
    most = field.get("maxItems")
    if most is None:
        length = f" of {least} or more" if least else ""
    elif least == most:
        length = f" of {most}"
    else:
        length = f" of {least} to {most}"
    items = field.get("prefixItems", [field.get("items", {})])
    kinds = dict.fromkeys(values_text(item) for item in items)
    return f"list{length}: {', '.join(kinds)}"


def to_yaml(value: Any) -> str:
    """Return a value as params.yaml has it, as code in Markdown."""
    text = json.dumps(value).replace('"', "")
    return f"`{text}`"


def to_markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose columns are not padded, because a description may be long."""
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for row in rows:
        cells = [cell.replace("|", r"\|") for cell in row]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    console.run(render)
