"""A file from an address, bounded in size and time: a server may say nothing for ever, or never end."""

import hashlib
import sys
import time
import urllib.request
from pathlib import Path

from tqdm import tqdm

from pipeline.base.atomic import replacing

TIMEOUT_S = 30  # of silence
SLOWEST = 10_000  # bytes a second, over all since the start but TIMEOUT_S
MOST_BYTES = 8 << 30  # the largest DINOv2 has 4.5 GB
_PART_BYTES = 1 << 20


def download(url: str, path: Path, sha256: str) -> None:
    """Write what is at a URL to `path`, which appears only if it is whole and has this SHA-256.

    Raises OSError (as URLError and TimeoutError are), HTTPException, or ValueError: the address is not one, the file is
    cut short, another one, larger than MOST_BYTES, or its content comes slower than SLOWEST.
    """
    request = urllib.request.Request(url, headers={"User-Agent": "semantic-steering"})  # some refuse Python's own
    digest, size, started = hashlib.sha256(), 0, time.monotonic()
    with replacing(path) as tmp:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer, tmp.open("wb") as file:
            length = int(answer.headers["Content-Length"] or 0)  # 0: it does not say
            _check_size(length)
            with tqdm(total=length or None, unit="B", unit_scale=True, disable=not sys.stderr.isatty()) as bar:
                while part := answer.read1(_PART_BYTES):  # what is there; read would wait for all of it, drop by drop
                    size += len(part)
                    _check_size(size)
                    if time.monotonic() - started > TIMEOUT_S + size / SLOWEST:
                        raise ValueError(f"it is slower than {SLOWEST / 1000:g} kB/s")
                    file.write(part)
                    digest.update(part)
                    bar.update(len(part))
        if size < length:
            raise ValueError(f"it is cut short: {size} of {length} bytes")
        if digest.hexdigest() != sha256:
            raise ValueError(f"it has the SHA-256 {digest.hexdigest()}, not {sha256}")


def _check_size(size: int) -> None:
    if size > MOST_BYTES:
        raise ValueError(f"it has at least {size} bytes, and {MOST_BYTES} are the most that is fetched")
