"""Names of the project's own presets."""

from pipeline.check.preset import PRESETS
from pipeline.ingest.datasets.kitti import IMPORT

# Without those that steer import wrote, whose files and encoder may be missing.
NAMES = [
    path.stem
    for path in sorted(PRESETS.glob("[a-z]*.yaml"))
    if not (PRESETS.parent / "data/raw" / path.stem / IMPORT).exists()
]
