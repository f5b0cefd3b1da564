"""The raw drive that an artefact goes back to: where its files lie, and whether they are still the same."""

from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.inspect import drive_file
from pipeline.inspect.apart import apart
from pipeline.inspect.reading import mapping
from pipeline.kitti.raw import RawDrive

_FOLDERS = {"town": "town", "kitti": "raw"}  # of ingest's `source`, beside data/ingest


def of_drives(path: Path, drives: list[str]) -> list[dict[str, Any]]:
    """Return of each drive its raw folder and the fingerprint that ingest took, as far as its ingest file is here.

    Of one drive alone, ``files`` says whether the raw files now are the same, changed or missing.
    """
    ingest = _ingest_folder(path)
    if ingest is None:
        return []
    return [_of_drive(ingest, drive, compare=len(drives) == 1) for drive in drives]


def _ingest_folder(path: Path) -> Path | None:
    above = path.absolute().parents
    return next((folder / "ingest" for folder in above if (folder / "ingest" / "index.json").is_file()), None)


def _of_drive(ingest: Path, drive: str, compare: bool) -> dict[str, Any]:
    try:
        made = apart(drive_file.summary, ingest / f"{drive}.h5")
    except InputError as error:
        return {"drive": drive, "error": str(error)}
    attributes, settings = made["attributes"], mapping(made["settings"].get("ingest"))
    source, fingerprint = str(attributes.get("source")), str(attributes.get("fingerprint", "unknown"))
    folder = ingest.parent / _FOLDERS.get(source, source) / drive[:10] / f"{drive}_sync"
    told = {"drive": drive, "raw": str(folder), "fingerprint": fingerprint}
    if not compare:
        return told
    if not folder.is_dir():
        return told | {"files": "missing"}
    cameras = [camera for camera in settings.get("cameras") or () if isinstance(camera, int)]
    return told | {"files": "same" if RawDrive(folder).fingerprint(cameras) == fingerprint else "changed"}
