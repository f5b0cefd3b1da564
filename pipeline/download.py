"""Files named by address and SHA-256: looked for on this machine first, fetched once, verified always."""

import re
import urllib.request
from pathlib import Path

from tqdm import tqdm

from pipeline.drives import file_hash
from pipeline.errors import InputError

SHA256 = re.compile(r"[0-9a-fA-F]{64}")
CACHE = Path("weights")
TIMEOUT_S = 30
CHUNK_BYTES = 1 << 20


def find(setting: str, key: str) -> tuple[Path, str]:
    """Return path and SHA-256 of the file that a setting names: ``PATH`` or ``URL``, with ``#sha256=HEX`` or without.

    A URL is looked for in the folder ``weights`` under its last part, and fetched to there if a hash says what it must
    be. `key` is the setting's name in params.yaml.

    Raises InputError if the file is missing and cannot be fetched, or is another one than the hash says.
    """
    name, _, wanted = setting.partition("#sha256=")
    if wanted and not SHA256.fullmatch(wanted):
        raise InputError(f"{key} = {setting}: a SHA-256 has 64 hexadecimal digits. sha256sum prints it")
    is_url = name.startswith(("https://", "http://", "file://"))
    path = CACHE / name.rsplit("/", 1)[-1] if is_url else Path(name)
    if is_url and not path.exists():
        if not wanted:
            raise InputError(
                f"{key}: {path} is missing, and without #sha256=HEX nothing is fetched. "
                f"Put the file there: curl -L -o {path} {name}"
            )
        _fetch(name, path, wanted.lower(), key)
    if not path.is_file():
        raise InputError(f"{key}: {name} is missing. Put the file there, or set weights: null to fit from the start")
    found = file_hash(path)
    if wanted and found != wanted.lower():
        raise InputError(
            f"{key}: {path} has the SHA-256 {found}, not {wanted.lower()}: it is damaged or another file. "
            "Delete it to get it again, or correct the hash"
        )
    return path, found


def _fetch(url: str, path: Path, wanted: str, key: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    tmp = path.with_name(path.name + ".tmp")
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as source, tmp.open("wb") as target:
            bytes_ = source.headers.get("Content-Length")
            with tqdm(total=int(bytes_) if bytes_ else None, unit="B", unit_scale=True, desc=path.name) as bar:
                while chunk := source.read(CHUNK_BYTES):
                    target.write(chunk)
                    bar.update(len(chunk))
        found = file_hash(tmp)
        if found != wanted:
            raise InputError(f"{key}: {url} gave a file of SHA-256 {found}, not {wanted}. Correct address or hash")
        tmp.replace(path)
    except OSError as error:  # URLError and timeouts are such
        raise InputError(
            f"{key}: {path} is missing and {url} cannot be fetched ({error}). Get it elsewhere and put it there"
        ) from error
    finally:
        tmp.unlink(missing_ok=True)
