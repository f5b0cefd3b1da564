"""Find the checkout of the code, and files in it."""

from pathlib import Path

# Folder of the packages of the code: the checkout, its copy in runs/NAME, or installed packages.
ROOT = Path(__file__).resolve().parents[2]
# File in runs/NAME, the working folder of a run, with the path of the checkout. Only the checkout
# has data/raw and weights. The file is not a link, as `runs` may be on a disk that has no links.
CHECKOUT = Path("checkout")


def is_checkout() -> bool:
    """Return whether this code is in a checkout, or in its copy in runs/NAME.

    It is in neither if it was installed as a wheel: ROOT is then a folder of installed packages.
    """
    return (ROOT / "dvc.yaml").is_file()


def in_checkout(path: Path) -> Path:
    """Return the path of a file in the checkout: `path` itself, unless this is a run."""
    if CHECKOUT.is_file():
        return Path(CHECKOUT.read_text(encoding="utf-8")) / path
    return path
