"""Find the checkout that a run in runs/NAME belongs to: it has data/raw and weights."""

from pathlib import Path

# File in runs/NAME with the path of the checkout. It is not a link, as `runs` may be on a disk that
# has no links.
CHECKOUT = Path("checkout")


def in_checkout(path: Path) -> Path:
    """Return the path of a file in the checkout: `path` itself, unless this is a run."""
    if CHECKOUT.is_file():
        return Path(CHECKOUT.read_text(encoding="utf-8")) / path
    return path
