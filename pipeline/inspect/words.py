"""What an artefact holds and where it came from, as lines for people."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.inspect.phrases import frames, many, size, spans, table

Content = Mapping[str, Any]


def artefact(told: Content) -> Iterator[str]:
    """Yield the lines of what :func:`pipeline.inspect.artefact.describe` returned."""
    yield f"{told['path']}: {told['kind']}, {size(told['bytes'])}"
    yield from _KINDS[told["kind"]](told)
    for section, settings in told.get("settings", {}).items():
        yield f"  made with {section}: {_short(settings)}"


def _drive_file(told: Content) -> Iterator[str]:
    yield f"  stage {told['stage']}, drive {told['drive']}: {frames(told['frames'])}"
    if told["attributes"]:
        yield f"  attributes: {_short(told['attributes'])}"
    rows = [("dataset", "shape", "dtype", "unit", "on disk", "share")]
    for one in told["datasets"]:
        shape = " × ".join(str(side) for side in one["shape"]) or "1"
        rows.append((one["name"], shape, one["dtype"], one["unit"], size(one["bytes"]), f"{one['share']:.1%}"))
    yield from table(rows)


def _drives(told: Content) -> Iterator[str]:
    count = len(told["drives"])
    yield f"  stage {told.get('stage', 'unknown')}: {told['frames']} frames of {many(count, 'drive')}"
    rows = [("drive", "split", "frames", "size", "gaps")]
    for drive, one in told["drives"].items():
        rows.append((drive, one["split"], str(one["count"]), size(one["bytes"]), spans(one["gaps"]) or "none"))
    yield from table(rows)
    if told["lacking"]:
        yield f"  named in index.json, but not here: {', '.join(told['lacking'])}"


def _model(told: Content) -> Iterator[str]:
    yield f"  line: {_short(told['line'])}"
    yield f"  {told['parameters']} parameters; best epoch {told['best_epoch']} of {told['epochs']}"
    yield f"  drives: {_short(told['drives'])}; seeds {told['seeds']}; code revision {told['revision']}"
    yield f"  target: {_short(told['target'])}"
    yield f"  curve's end: {_short(told['curve_end'])}"
    if len(told["networks"]) > 1:
        yield f"  networks: {', '.join(told['networks'])}"


def _encoder(told: Content) -> Iterator[str]:
    yield f"  fitted to frames of {many(told['drives'], 'drive')}; curve's end: {_short(told['curve_end'])}"


def _evaluation(told: Content) -> Iterator[str]:
    yield f"  model {told['name']}: {_short(told['line'])}"
    sizes = f"{told['points_per_frame']} points and {told['edges_per_frame']} edges a frame"
    yield f"  {told['parameters']} parameters, {sizes}"
    for split, errors in told["errors"].items():
        yield f"  {split}: {_short(errors) if errors else 'no drives'}"


def _figures(told: Content) -> Iterator[str]:
    yield from table((key, f"{value:.6g}") for key, value in told["figures"].items())


def _folders(told: Content) -> Iterator[str]:
    for name, part in told["parts"].items():
        rest = {key: value for key, value in part.items() if key not in ("kind", "bytes", "error")}
        if "error" in part:
            yield f"  {name}: {part['error']}"
        else:
            counts = "".join(f", {value} {key.replace('_', ' ')}" for key, value in rest.items())
            yield f"  {name}: {part['kind']}{counts}, {size(part['bytes'])}"


def _raw_drive(told: Content) -> Iterator[str]:
    rows = [("modality", "files", "frames", "missing between", "size", "timestamps")]
    for name, one in told["modalities"].items():
        span = f"{one['first']} to {one['last']}" if one["files"] else "none"
        rows.append(
            (
                name,
                str(one["files"]),
                span,
                spans(one.get("gaps", [])) or "none",
                size(one["bytes"]),
                str(one["stamps"]),
            )
        )
    yield from table(rows)
    yield f"  calibration: {', '.join(told['calibration']) or 'none'}"


def _raw_root(told: Content) -> Iterator[str]:
    names = list(dict.fromkeys(name for one in told["drives"].values() for name in one))
    rows = [("drive", *names)]
    rows += [(drive, *(str(one.get(name, "-")) for name in names)) for drive, one in told["drives"].items()]
    yield from table(rows)


def _pictures(told: Content) -> Iterator[str]:
    yield f"  of {many(len(told['made_of']), 'drive')}: {', '.join(told['made_of'])}"


_KINDS = {
    "drive file": _drive_file,
    "folder of drives": _drives,
    "model": _model,
    "encoder": _encoder,
    "evaluation": _evaluation,
    "figures": _figures,
    "folder of artefacts": _folders,
    "pictures": _pictures,
    "raw drive": _raw_drive,
    "folder of raw drives": _raw_root,
}


def provenance(chain: Content, raw: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of where it came from: the stages, the last one first, then the raw drives."""
    yield "where it came from"
    if chain["stages"]:
        yield f"  by {chain['project']}/dvc.lock, the last stage first"
    else:
        yield f"  not known stage by stage: {chain['why']}"
    if chain.get("unread"):
        yield f"  not compared with params.yaml: {chain['unread']}"
    for out in chain.get("altered", []):
        yield f"  {out} has other sizes than dvc.lock says: written since, or not whole"
    for stage in chain["stages"]:
        yield from _stage(stage)
    if len(raw) > 1:
        roots = sorted({str(Path(one["raw"]).parents[1]) for one in raw if "raw" in one})
        unread = sum("error" in one for one in raw)
        more = (
            f"; of {unread} the ingest file cannot be read here" if unread else ": steer show a drive's file says more"
        )
        yield f"  {len(raw)} raw drives{' in ' + ', '.join(roots) if roots else ''}{more}"
    for one in raw[:1] if len(raw) == 1 else ():
        if "error" in one:
            yield f"  raw drive: {one['error']}"
        else:
            state = {"same": "still the same", "changed": "OTHER FILES NOW", "missing": "not here"}[one["files"]]
            yield f"  raw drive {one['raw']}: {state}, fingerprint {one['fingerprint']}"


def _stage(stage: Content) -> Iterator[str]:
    yield f"  {stage['name']}: {stage['cmd']}"
    for key, value in stage["settings"].items():
        yield f"    {key}: {_short(value)}"
    for key, value in stage["settings_now"].items():
        yield f"    params.yaml says otherwise now: {key}: {_short(value)}"
    for path, md5 in stage["inputs"].items():
        yield f"    from {path}, {md5}{', MADE AGAIN SINCE: below is the new one' if path in stage['remade'] else ''}"
    other = [f"{path} ({state})" for path, state in stage["code"].items() if state != "same"]
    yield f"    code: {'changed since it was made: ' + ', '.join(other) if other else 'still that which made it'}"


def _short(value: Any) -> str:
    """Return a value on one line, without the quotes and brackets of JSON around what is a mapping."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {json.dumps(one, ensure_ascii=False, default=str)}" for key, one in value.items())
    return json.dumps(value, ensure_ascii=False, default=str)
