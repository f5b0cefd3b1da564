"""Names of the project's own presets."""

from pipeline.check.preset import IMPORT, PRESETS

# Without those that steer import wrote, whose files and encoder may be missing, or which an earlier
# version wrote.
NAMES = [
    path.stem
    for path in sorted(PRESETS.glob("[a-z]*.yaml"))
    if not path.read_text(encoding="utf-8").startswith(f"# Written by {IMPORT};")
]
