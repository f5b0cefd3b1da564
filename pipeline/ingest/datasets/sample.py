"""The rendered drives of stage sample, in KITTI raw's layout."""

from pathlib import Path
from typing import Any

from pipeline.base.hashes import file_hash
from pipeline.ingest.datasets import kitti
from pipeline.ingest.settings import Ingest

open_drive = kitti.open_drive


def fingerprint(name: str, settings: Ingest, root: Path) -> list[Any]:
    """Return names and hashes of a drive's files, as each checkout has other file times."""
    folder = root / name[:10]
    paths = kitti.find_drive(root, name).list_files()
    return [[str(path.relative_to(folder)), file_hash(path)] for path in paths]
