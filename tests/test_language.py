"""Phrases that STYLE asks to avoid, in code, documentation and names of tests.

python -m tests.test_language    # prints all hits, and their number per package
"""

import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from pipeline.base.resume import ROOT

SOURCES = (
    "pipeline", "models", "stages", "steer", "benchmarks", "README.md", "docs", "params.yaml", "presets", "dvc.yaml",
    "CONTRIBUTING.md", "data/README.md", "Makefile", "tests",
)  # fmt: skip
DATA = "files?|folders?|stages?|sections?|keys?|settings?|reports?|tables?|pages?|DVC|HDF5|git"
PROGRAM = "networks?|models?|encoders?|trainers?|readers?|writers?|workers?|process(?:es)?|schedulers?|stages?|DVC|HDF5"
# Plain alternatives: get, report, state; its own; n; expected …, got …; no process, no user; the … of.
PHRASES = {
    "data that is told or said": r"\b(told|said|tells?|says)\b",
    "whose own": r"\bwhose own\b",
    "so many": r"\bso many\b|\bas (?:many|often) times as so\b",
    "is no (instead of: expected …, got …)": r"\bis no (?:\w+ )?(?:file|folder|directory|number|image|drive|path)\b",
    "nobody": r"\bnobody(?:'s)?\b",
    "that of": r"\bthat of\b",
    "data that stands or lies": rf"\b(?:{DATA}) (?:stands?|lies?|lied)\b",
    "personified programs": rf"\b(?:{PROGRAM}) (?:knows?|believes?|wants?|hears?)\b",
    "means nothing to": r"\bmeans nothing\b",
    "what it knows, what it sees": r"\bwhat (?:it|they|one|somebody) (?:knows?|sees?|saw|hears?|heard|believes?)\b",
    "rooms (packages)": r"\brooms\b",
    "who (of programs)": r"\bwhoever\b|\bwho wants\b|\bto whom\b",
    "circles (import cycles)": r"\bno circles?\b",
}
# Participles as nouns, and of_x; seen and known are idioms of Python (seen = set()).
NAMES = re.compile(r"_*(?:told|said|kept|held|judged|heard|of_[a-z]\w*|\w+_(?:told|said|judged))")
SUFFIXES = (".py", ".md", ".yaml", "Makefile")
SKIPPED = ("tests/test_language.py",)


def files() -> Iterator[Path]:
    for source in SOURCES:
        root = ROOT / source
        paths = sorted(root.rglob("*")) if root.is_dir() else [root]
        yield from (path for path in paths if path.name.endswith(SUFFIXES) and path.is_file())


def hits(path: Path) -> Iterator[tuple[int, str, str]]:
    """Yield line number, phrase and line. Of tests, only names of tests are searched."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    of_tests = path.relative_to(ROOT).parts[0] == "tests"
    for number, line in enumerate(lines, 1):
        searched = re.sub("_", " ", "".join(re.findall(r"def (test_\w+)", line))) if of_tests else line
        for name, pattern in PHRASES.items():
            if re.search(pattern, searched):
                yield number, name, line.strip()
    if path.suffix == ".py" and not of_tests:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.NAME and NAMES.fullmatch(token.string):
                yield token.start[0], f"the name {token.string}", lines[token.start[0] - 1].strip()


def all_hits() -> list[str]:
    names = [path for path in files() if str(path.relative_to(ROOT)) not in SKIPPED]
    return [f"{path.relative_to(ROOT)}:{number}: {name}: {line}" for path in names for number, name, line in hits(path)]


def test_plain_english() -> None:
    found = all_hits()
    assert not found, "\n".join([f"{len(found)} phrases to rewrite:", *found])


if __name__ == "__main__":
    found = all_hits()
    packages = Counter("/".join(Path(hit.split(":")[0]).parts[:2]) for hit in found)
    phrases = Counter("names" if "the name" in hit else hit.split(": ")[1] for hit in found)
    print(*found, *(f"{number:5} {name}" for name, number in (packages | phrases).most_common()), sep="\n")
    sys.exit(bool(found))
