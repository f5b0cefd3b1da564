"""Ways in which a file's bytes come to differ from what was written."""

from collections.abc import Callable

import numpy as np

Mutation = Callable[[bytearray, np.random.Generator], bytes]

_WORDS = (
    "nan inf -inf 1e400 -1e300 1e300 1e5 100000 0 -1 1_0 １２ now today NaT 2026_02_31_drive_0001 2026-02-31 null true "
    "../../etc/passwd [] {} {a:{}} *a &a !!binary !!python/name:os.system <<:*a ' ? | %TAG"
)
_HOSTILE = [word.encode() for word in _WORDS.split(" ")] + [
    b"9" * 30, b"9" * 5000, b"0x" + b"f" * 500, b"[" * 3000, b"\xff\xfe", b"\x00", b"&a [*a, *a]", b"- -",
]  # fmt: skip


def bit(content: bytearray, rng: np.random.Generator) -> bytes:
    """One flipped bit."""
    content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
    return bytes(content)


def some_bytes(content: bytearray, rng: np.random.Generator) -> bytes:
    """Up to sixteen bytes that are others."""
    for at in rng.integers(len(content), size=int(rng.integers(1, 17))):
        content[int(at)] = int(rng.integers(256))
    return bytes(content)


def a_run(content: bytearray, rng: np.random.Generator) -> bytes:
    """Zeros, ones or noise in the place of a run of bytes."""
    start, length = _run(content, rng)
    noise = rng.integers(256, size=length, dtype=np.uint8).tobytes()
    content[start : start + length] = [bytes(length), b"\xff" * length, noise][int(rng.integers(3))]
    return bytes(content)


def cut(content: bytearray, rng: np.random.Generator) -> bytes:
    """The end is missing."""
    return bytes(content[: int(rng.integers(len(content)))])


def without_a_run(content: bytearray, rng: np.random.Generator) -> bytes:
    """Some bytes are missing within."""
    start, length = _run(content, rng)
    del content[start : start + length]
    return bytes(content)


def with_a_run_twice(content: bytearray, rng: np.random.Generator) -> bytes:
    """Some bytes stand there twice, the second time maybe elsewhere."""
    start, length = _run(content, rng)
    at = int(rng.integers(len(content) + 1))
    content[at:at] = content[start : start + length]
    return bytes(content)


def a_word(content: bytearray, rng: np.random.Generator) -> bytes:
    """Another word, of those that readers of text have trouble with."""
    ends = [at for at, byte in enumerate(content) if byte in b" \n:,[]{}\"'"]
    at = int(rng.integers(len(ends) - 1)) if len(ends) > 1 else 0
    start, stop = (ends[at] + 1, ends[at + 1]) if len(ends) > 1 else (0, len(content))
    content[start:stop] = _HOSTILE[int(rng.integers(len(_HOSTILE)))]
    return bytes(content)


BINARY: tuple[Mutation, ...] = (bit, bit, some_bytes, a_run, cut, without_a_run, with_a_run_twice)
TEXT: tuple[Mutation, ...] = (bit, some_bytes, cut, without_a_run, with_a_run_twice, a_word, a_word, a_word)


def _run(content: bytearray, rng: np.random.Generator) -> tuple[int, int]:
    length = min(len(content), int(2 ** rng.uniform(0, 12)))
    return int(rng.integers(len(content) - length + 1)), length
