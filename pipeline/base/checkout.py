"""The checkout of a run: runs/NAME takes data/raw and weights from there."""

from pathlib import Path

# File in runs/NAME with the path of the checkout: `runs` may be on another disk, and some disks
# have no links.
CHECKOUT = Path("checkout")


def in_checkout(path: Path) -> Path:
    """Return the path of a file of the checkout; `path` itself, unless this process works in
    runs/NAME.
    """
    if CHECKOUT.is_file():
        return Path(CHECKOUT.read_text(encoding="utf-8")) / path
    return path
