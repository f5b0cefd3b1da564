"""What others fitted for the unified encoder: files named by path, or by address and SHA-256.

A file is looked for on this machine first, fetched once, and verified always.
"""

import http.client
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError, error_context
from pipeline.base.resume import file_hash
from pipeline.encoder import download
from pipeline.fitting import checkpoint

SHA256 = re.compile(r"[0-9a-fA-F]{64}")
SETTING = re.compile(r"(.*?)(?:#as=(.*?)(?=#|&|$))?(?:[#&]sha256=(.*))?", re.DOTALL)
CACHE = Path("weights")
Setting = str | Mapping[str, str] | None
"""A checkpoint of this project, or a published file for each of some parts, or nothing."""
WRAPPERS = ("state_dict", "model")  # what published files call their tensors, where they hold more than these


@dataclass(frozen=True)
class Source:
    """A file that weights came from, and the part of the encoder that it filled; "all" for a whole checkpoint."""

    part: str
    path: str
    sha256: str


def files(setting: Setting, key: str) -> dict[str, str]:
    """Return the files that a setting of this `key` names, each under its own key."""
    if isinstance(setting, str):
        return {key: setting}
    return {f"{key}.{part}": file for part, file in (setting or {}).items()}


def locate(file: str, key: str) -> Path:
    """Return where a file of a setting lies, or will once :func:`find` has fetched it; nothing is read.

    Raises InputError if the file is missing and nothing would be fetched.
    """
    name, place, wanted = split(file)
    if wanted and not SHA256.fullmatch(wanted):
        raise InputError(f"{key} = {file}: a SHA-256 has 64 hexadecimal digits. sha256sum prints it")
    is_url = name.startswith(("https://", "http://", "file://"))
    if place and (not is_url or Path(place).is_absolute() or ".." in Path(place).parts):
        raise InputError(f"{key} = {file}: #as= is where in {CACHE}/ the file of a URL lies, such as net/encoder.pth")
    path = CACHE / (place or name.rsplit("/", 1)[-1]) if is_url else Path(name)
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


def split(file: str) -> tuple[str, str, str]:
    """Return path or URL, place in the folder ``weights``, and SHA-256 of a file of a setting; "" for what is not said.

    ``PATH``, ``PATH#sha256=HEX``, ``URL``, ``URL#sha256=HEX`` or, where the last part of the URL says too little,
    ``URL#as=PLACE&sha256=HEX``.
    """
    name, place, wanted = SETTING.fullmatch(file).groups(default="")  # type: ignore[union-attr]  # it matches any text
    return name, place, wanted


def find(file: str, key: str) -> tuple[Path, str]:
    """Return path and SHA-256 of a file of a setting, as :func:`split` takes it apart.

    A URL is looked for in the folder ``weights`` under its place there, else under its last part, and fetched to there
    if a hash says what it must be. `key` is the setting's name in params.yaml.

    Raises InputError if the file is missing and cannot be fetched, or is another one than the hash says.
    """
    path = locate(file, key)
    name, _, wanted = split(file)
    wanted = wanted.lower()
    if not path.exists():
        _fetch(name, path, wanted, key)
    sha256 = file_hash(path)
    if wanted and sha256 != wanted:
        raise InputError(
            f"{key}: {path} has the SHA-256 {sha256}, not {wanted}: it is damaged or another file. "
            "Delete it to get it again, or correct the hash"
        )
    return path, sha256


def _fetch(url: str, path: Path, wanted: str, key: str) -> None:
    try:
        download.download(url, path, wanted)
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{key}: {path} is missing and {url} cannot be fetched ({reason}). "
            f"Correct address or hash, or put the file there: curl --create-dirs -L -o {path} {url}"
        ) from error


def read_published(path: Path) -> dict[str, Any]:
    """Return the tensors by name of a plain state dict, alone in its file or beside facts of its training.

    Raises InputError if the file is cut short, or holds code, or no tensors.
    """
    from pipeline.encoder.perceive import is_state

    content = checkpoint.load(path)
    candidates: list[Any] = []
    if isinstance(content, dict):
        bare = {name: value for name, value in content.items() if not isinstance(value, int | float)}  # Monodepth2's
        candidates = [bare, *(content.get(name) for name in WRAPPERS)]
    for state in candidates:
        if is_state(state) and state:
            return dict(state)
    raise InputError(f"{path} is not a plain state dict, tensors by name")


def fill(model: Any, backbone: str, setting: Setting, key: str) -> list[Source]:
    """Fill a unified encoder's parts as a setting says; return the files that were used.

    Args:
        model: a torch module with the children backbone, depth_head and class_head.
        backbone: what kind it is.
        setting: its files, each a path or URL as :func:`find` takes them.
        key: the setting's name in params.yaml, for messages.

    Raises InputError if a file is missing, is not what its hash says, or does not fit the network one by one.
    """
    hint = f"Name another file in {key}"
    if isinstance(setting, str):
        return [_fill_all(model, backbone, setting, key, hint)]
    sources = []
    for name, file in (setting or {}).items():
        path, sha256 = find(file, f"{key}.{name}")
        part = getattr(model, name)
        with error_context(fix=hint):
            checkpoint.load_state(part, part.own_names(read_published(path)), path)
        sources.append(Source(name, str(path), sha256))
    return sources


def _fill_all(model: Any, backbone: str, file: str, key: str, hint: str) -> Source:
    from pipeline.encoder import perceive

    path, sha256 = find(file, key)
    with error_context(fix=f"{hint}; a published file is named by part: {key}: {{backbone: {path}}}"):
        weights = perceive.read(path)
    with error_context(fix=hint):
        if weights.backbone != backbone:
            raise InputError(f"{path} holds backbone {weights.backbone!r}, expected {backbone!r}")
        checkpoint.load_state(model, weights.state, path)
    return Source("all", str(path), sha256)


def unnamed(model: Any, setting: Setting, parts: Sequence[str]) -> str | None:
    """Return the first of `parts` that has something to fit and that no file fills; a checkpoint fills all."""
    if isinstance(setting, str):
        return None
    candidates = (part for part in parts if part not in (setting or {}))
    return next((part for part in candidates if any(True for _ in getattr(model, part).parameters())), None)
