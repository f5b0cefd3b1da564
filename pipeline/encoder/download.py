"""Files named by address and SHA-256: looked for on this machine first, fetched once, verified always."""

import http.client
import re
import sys
import urllib.request
from pathlib import Path

from tqdm import tqdm

from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash

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
    path = locate(setting, key)
    name, _, wanted = setting.partition("#sha256=")
    if not path.exists():
        _fetch(name, path, wanted.lower(), key)
    found = file_hash(path)
    if wanted and found != wanted.lower():
        raise InputError(
            f"{key}: {path} has the SHA-256 {found}, not {wanted.lower()}: it is damaged or another file. "
            "Delete it to get it again, or correct the hash"
        )
    return path, found


def locate(setting: str, key: str) -> Path:
    """Return where the file that a setting names lies, or will once :func:`find` has fetched it; nothing is read.

    Raises InputError if the file is missing and nothing would be fetched.
    """
    name, _, wanted = setting.partition("#sha256=")
    if wanted and not SHA256.fullmatch(wanted):
        raise InputError(f"{key} = {setting}: a SHA-256 has 64 hexadecimal digits. sha256sum prints it")
    is_url = name.startswith(("https://", "http://", "file://"))
    path = CACHE / name.rsplit("/", 1)[-1] if is_url else Path(name)
    if path.is_dir() or path == CACHE:
        raise InputError(f"{key}: {name} is a folder. Name a file")
    if not path.exists() and not is_url:
        raise InputError(f"{key}: {name} is missing. Put the file there, or name another one")
    if not path.exists() and not wanted:
        raise InputError(
            f"{key}: {path} is missing, and without #sha256=HEX nothing is fetched. "
            f"Put the file there: curl --create-dirs -L -o {path} {name}"
        )
    return path


def _fetch(url: str, path: Path, wanted: str, key: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    tmp = path.with_name(path.name + ".tmp")
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as source, tmp.open("wb") as target:
            length = source.headers.get("Content-Length")
            total = int(length) if length else None
            hidden = not sys.stderr.isatty()
            with tqdm(total=total, unit="B", unit_scale=True, desc=path.name, disable=hidden) as bar:
                while chunk := source.read(CHUNK_BYTES):
                    target.write(chunk)
                    bar.update(len(chunk))
            if total and target.tell() < total:
                raise EOFError(f"cut short at {target.tell()} of {total} bytes")
        found = file_hash(tmp)
        if found != wanted:
            raise InputError(f"{key}: {url} gave a file of SHA-256 {found}, not {wanted}. Correct address or hash")
        tmp.replace(path)
    except InputError:  # a ValueError too
        raise
    # URLError and timeouts are OSErrors; addresses and lengths that are none, ValueErrors or HTTPExceptions.
    except (OSError, EOFError, ValueError, http.client.HTTPException) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{key}: {path} is missing and {url} cannot be fetched ({reason}). Get it elsewhere and put it there"
        ) from error
    finally:
        tmp.unlink(missing_ok=True)
