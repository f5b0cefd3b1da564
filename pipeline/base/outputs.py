"""Where a command writes: a folder that does not exist or is empty, or a file that does not exist."""

from itertools import count
from pathlib import Path

from pipeline.base.errors import InputError

WORK = ".work"


def check_free(path: Path, key: str = "") -> None:
    """Raise InputError unless the file or folder `path` does not exist, or is a folder that :func:`claim` may take."""
    if path.exists() and not _is_empty(path, key):
        raise InputError("exists already", path, "Pass another --out, or move it away")


def claim(out: Path | None, stem: str, key: str = "") -> Path:
    """Return the folder for a command's results: `out`, otherwise the first free one of out/STEM, out/STEM-2, ….

    Args:
        out: the option --out.
        stem: name of the recording.
        key: a hash of the recording and the settings. A folder that only holds ``.work/KEY``, from a killed run, counts
            as empty, and without `out` it is preferred.

    Raises InputError if `out` is not free.
    """
    if out is not None:
        check_free(out, key)
        return out
    folders = Path("out")
    for folder in sorted(folders.glob("*")):
        if folder.name.startswith(stem) and (folder / WORK / key).exists() and _is_empty(folder, key):
            return folder
    names = (f"{stem}-{number}" if number > 1 else stem for number in count(1))
    return next(folders / name for name in names if not (folders / name).exists() or _is_empty(folders / name, key))


def _is_empty(folder: Path, key: str) -> bool:
    if not folder.is_dir():
        return False
    contents = [path.name for path in folder.iterdir()]
    return not contents or (contents == [WORK] and [path.name for path in (folder / WORK).iterdir()] == [key])
