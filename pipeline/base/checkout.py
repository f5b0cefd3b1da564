"""Find the checkout of a run in runs/NAME, which takes data/raw and weights from there."""

from pathlib import Path

# File in runs/NAME with the path of the checkout. It is no link: `runs` may be on another disk, and
# some disks have no links.
CHECKOUT = Path("checkout")


def in_checkout(path: Path) -> Path:
    """Return the path of a file in the checkout: `path` itself, unless this is a run."""
    if CHECKOUT.is_file():
        return Path(CHECKOUT.read_text(encoding="utf-8")) / path
    return path
