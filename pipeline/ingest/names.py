"""Find the files of one recording by one camera, and their order, by their names."""

import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.resume import content_hash

# Suffixes of images.
PICTURES = (".png", ".jpg", ".jpeg")
# Suffixes of videos.
VIDEOS = (".mp4", ".mov", ".mkv", ".avi", ".ts", ".mts", ".webm")
# Largest number of images per video in a folder at which the images are thumbnails or photographs.
# If there are more, the images are the recording.
BESIDE = 10
# Largest number of patterns of names that an error message lists.
NAMED = 6
# Pattern of a number in a name. A time counts as one number: 2024-05-01_12-00-00, 20240501_120000,
# 20240501120000123, and 12-00-00 without a date.
_NUMBER = re.compile(
    r"(20\d\d\D?\d\d\D?\d\d\D?\d\d\D?\d\d\D?\d\d\d*|\d\d[-.]\d\d[-.]\d\d(?!\d)|\d+)"
)
# Pattern of a name by a GoPro camera. GX020042 is the second chapter of recording 0042. Older
# cameras write GOPR0042, then GP010042.
_GOPRO = re.compile(r"(G[HLSX](?=\d{6})|GP(?=\d{6})|GOPR(?=\d{4}$))(\d\d)??(\d{4})")
# Pattern of a name by a BlackVue camera. 20240501_120000_NF has the mode N and the camera F. Other
# modes are E for events and P for parking.
_BLACKVUE = re.compile(r"(\d{8}_\d{6})_[A-Z]([A-Z])")


def check_name(path: Path) -> None:
    """Raise InputError if a path is not UTF-8, which HDF5 and JSON files need."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        readable = str(path).encode(errors="replace").decode()
        raise InputError("name is not UTF-8", readable, "Rename the file or folder") from error


def check_different(paths: Sequence[Path]) -> None:
    """Raise InputError if two files, or two folders, have the same content.

    Missing files are skipped, as the caller reports them.
    """
    path_of = dict[str, Path]()
    for path in paths:
        if not path.exists():
            continue
        content = content_hash(path)
        if content in path_of:
            raise InputError(
                f"has the same content as {path_of[content]}", path, "Pass each recording once"
            )
        path_of[content] = path


def videos_in(folder: Path) -> tuple[list[Path], list[str]]:
    """Return the videos of a folder in order, and notes on ignored files.

    The list of videos is empty if the folder's images are the recording. Raises InputError for
    videos of several cameras or recordings.
    """
    videos = visible(folder, VIDEOS)
    pictures = visible(folder, PICTURES)
    if not videos:
        return [], []
    if len(pictures) > BESIDE * len(videos):
        return [], [f"the folder's {len(pictures)} images are used, not {_some(videos)}"]

    groups = group(videos)
    patterns = sorted(groups)
    if len(patterns) > 1:
        named = ", ".join(patterns[:NAMED])
        if len(patterns) > NAMED:
            named += f" and {len(patterns) - NAMED} more"
        front = [pattern for pattern in patterns if "front" in pattern.lower()]
        example = folder / (front + patterns)[0]
        raise InputError(
            f"has videos of {len(patterns)} cameras or recordings: {named}",
            folder,
            f"Pass the files of one, for instance {example}",
        )
    notes = list[str]()
    if pictures:
        notes.append(f"the folder's {len(videos)} videos are used, not {_some(pictures)}")
    return groups[patterns[0]], notes


def _some(files: Sequence[Path]) -> str:
    """Return the name of the first file, and the number of the others."""
    if len(files) == 1:
        return files[0].name
    return f"{files[0].name} and {len(files) - 1} more"


def group(files: Sequence[Path]) -> dict[str, list[Path]]:
    """Return the files of each recording in order, by a pattern of their names.

    The names of one recording differ in one number, which is * in the pattern. Further numbers may
    rise together with it, such as a counter beside a time; they are *, too.
    """
    alike = defaultdict[tuple[str, ...], list[Path]](list)
    for path in files:
        texts = _split_name(path)[::2]
        alike[(*texts, path.suffix.lower())].append(path)

    groups = dict[str, list[Path]]()
    for paths in alike.values():
        for pattern, members in _by_rising_number(sorted(paths, key=_numbers)).items():
            key = pattern if len(members) > 1 else members[0].name
            groups[key] = members
    return groups


def _by_rising_number(paths: Sequence[Path]) -> dict[str, list[Path]]:
    """Return pattern → files, for files in order whose names have the same texts.

    Files of one group differ only in the numbers that rise.
    """
    rows = [_numbers(path) for path in paths]
    values = [set(column) for column in zip(*rows, strict=True)]
    rising = [place for place, column in enumerate(values) if len(column) > 1]
    if not all(_rise(before, after) for before, after in pairwise(rows)):
        # Some number falls, so there are several recordings, and only one number counts the files
        # of each. It is the one with the most values; of several such numbers, the last.
        most = max(len(column) for column in values)
        rising = [place for place in rising if len(values[place]) == most][-1:]

    groups = defaultdict[str, list[Path]](list)
    for path in paths:
        # The numbers are every second part.
        parts = _split_name(path)
        for place in rising:
            parts[2 * place + 1] = "*"
        groups["".join(parts) + paths[0].suffix].append(path)
    return groups


def _rise(before: Sequence[int], after: Sequence[int]) -> bool:
    """Return whether no number is smaller in `after` than in `before`."""
    return all(first <= second for first, second in zip(before, after, strict=True))


def _split_name(path: Path) -> list[str]:
    """Return the parts of a name: text, number, text, and so on.

    A GoPro camera's number of a recording counts as a text, so that its chapters stay together.
    """
    gopro = _GOPRO.fullmatch(path.stem)
    if gopro:
        camera, chapter, recording = gopro.groups()
        if camera in ("GP", "GOPR"):
            camera = "G"
        return [camera, chapter or "0", recording]
    blackvue = _BLACKVUE.fullmatch(path.stem)
    if blackvue:
        time, camera = blackvue.groups()
        return ["", time, f"_?{camera}"]
    return _NUMBER.split(path.stem)


def _numbers(path: Path) -> list[int]:
    """Return the numbers in a name."""
    return [int(re.sub(r"\D", "", part)) for part in _split_name(path)[1::2]]


def order_doubts(paths: Sequence[Path]) -> list[str]:
    """Return a doubt on videos in the order that a user passed, if their names say otherwise."""
    groups = group(paths)
    patterns = {path: pattern for pattern, members in groups.items() for path in members}
    # If the files of each group are together, the group changes len(groups) - 1 times.
    changes = sum(patterns[before] != patterns[after] for before, after in pairwise(paths))
    if changes >= len(groups):
        return [
            f"files of {' and '.join(sorted(groups)[:NAMED])} take turns: are these several "
            "cameras or recordings?"
        ]
    for members in groups.values():
        passed = [path for path in paths if path in members]
        for before, after in pairwise(passed):
            if members.index(after) < members.index(before):
                return [
                    f"{after.name} follows {before.name}, unlike the numbers in their names: is "
                    "the order right?"
                ]
    return []


def visible(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Return a folder's files with these suffixes, ordered by the numbers in their names."""
    files = [
        path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.name[0] != "."
    ]
    return sorted(files, key=lambda path: (words(path), path.name))


def words(path: Path) -> list[str | int]:
    """Return the texts and the numbers of a name in turn, so that img_9 sorts before img_10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.stem)]
