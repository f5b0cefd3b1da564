"""Say whether this code is in a checkout, and find the checkout of a run in runs/NAME.

The checkout has data/raw and weights. An installed wheel has neither.
"""

from pathlib import Path

from pipeline.base.resume import ROOT

# File in runs/NAME with the path of the checkout. It is not a link, as `runs` may be on a disk that
# has no links.
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
