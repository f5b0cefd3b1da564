"""Where what a report tells of lies."""

from pathlib import Path


class Sources:
    """Folders of other stages. All but `evaluate` may be missing, as on a machine that only trains."""

    def __init__(self, data: Path) -> None:
        """`data` holds a folder for each stage."""
        self.evaluate, self.train, self.labels, self.pictures = (
            data / stage for stage in ("evaluate", "train", "labels", "pictures")
        )
        self.ingest, self.perception, self.scores = (data / stage for stage in ("ingest", "perception", "scores"))
        self.clouds = data / "clouds/pseudo"
