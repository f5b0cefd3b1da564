"""Whether files and folders are still those that dvc.lock names, by DVC's own hashing, without writing its state."""

from pathlib import Path


class CodeHashes:
    """Hashes paths of one project as DVC does, .dvcignore respected; each once."""

    def __init__(self, project: Path) -> None:
        from dvc.fs import LocalFileSystem
        from dvc.ignore import DvcIgnoreFilter
        from dvc_data.hashfile.db import HashFileDB

        self._project = project
        self._fs = LocalFileSystem()
        self._ignore = DvcIgnoreFilter(self._fs, str(project))
        self._nowhere = HashFileDB(self._fs, str(project))  # DVC asks for a cache; a dry run leaves it alone
        self._known: dict[str, str | None] = {}

    def compare(self, path: str, md5: str) -> str:
        """Say whether `path`, relative to the project, has this hash: same, changed or missing."""
        if path not in self._known:
            self._known[path] = self._hash(self._project / path)
        now = self._known[path]
        return "missing" if now is None else "same" if now == md5 else "changed"

    def _hash(self, path: Path) -> str | None:
        from dvc_data.hashfile.build import build

        if not path.exists():
            return None
        _, _, made = build(self._nowhere, str(path), self._fs, "md5", dry_run=True, ignore=self._ignore)
        return made.hash_info.value if made.hash_info else None
