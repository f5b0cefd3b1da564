"""Find the files of one recording, of one camera and in order, by their names."""

import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.resume import content_hash

PICTURES = (".png", ".jpg", ".jpeg")
VIDEOS = (".mp4", ".mov", ".mkv", ".avi", ".ts", ".mts", ".webm")
# Largest number of pictures per video of a folder that are thumbnails or photographs; more of them
# are a recording.
BESIDE = 10
# Number of patterns of names in an error message.
NAMED = 6
# A number in a name. Times are one number: 2024-05-01_12-00-00, 20240501_120000, 20240501120000123,
# and 12-00-00 without a date.
_NUMBER = re.compile(
    r"(20\d\d\D?\d\d\D?\d\d\D?\d\d\D?\d\d\D?\d\d\d*|\d\d[-.]\d\d[-.]\d\d(?!\d)|\d+)"
)
# A name of GoPro: GX020042 is the second chapter of recording 0042; of older cameras, GP010042
# follows GOPR0042.
_GOPRO = re.compile(r"(G[HLSX](?=\d{6})|GP(?=\d{6})|GOPR(?=\d{4}$))(\d\d)??(\d{4})")
# A name of BlackVue: 20240501_120000_NF has the mode N (others are E for events, P for parking),
# and the camera F.
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

    Missing ones are for the caller.
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

    There are no videos if the folder's images are the recording. Raises InputError for videos of
    several cameras or recordings.
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

    Names of one recording differ in one number, for which * stands. Others may rise with it, as a
    counter does with the time.
    """
    alike = defaultdict[tuple[str, ...], list[Path]](list)
    for path in files:
        texts = _split_name(path)[::2]
        alike[(*texts, path.suffix.lower())].append(path)

    groups = dict[str, list[Path]]()
    for paths in alike.values():
        for pattern, members in _by_rising_number(sorted(paths, key=_numbers)).items():
            groups[pattern if len(members) > 1 else members[0].name] = members
    return groups


def _by_rising_number(paths: Sequence[Path]) -> dict[str, list[Path]]:
    """Group files, in order, whose names have the same texts, by the numbers that do not rise."""
    rows = [_numbers(path) for path in paths]
    values = [set(column) for column in zip(*rows, strict=True)]
    rising = [place for place, column in enumerate(values) if len(column) > 1]
    if not all(_rise(before, after) for before, after in pairwise(rows)):
        # Only one number counts the files: the last of those with the most values.
        most = max(len(column) for column in values)
        rising = [place for place in rising if len(values[place]) == most][-1:]

    groups = defaultdict[str, list[Path]](list)
    for path in paths:
        parts = _split_name(path)
        for place in rising:
            parts[2 * place + 1] = "*"
        groups["".join(parts) + paths[0].suffix].append(path)
    return groups


def _rise(before: Sequence[int], after: Sequence[int]) -> bool:
    """Return whether no number is smaller after than before."""
    return all(first <= second for first, second in zip(before, after, strict=True))


def _split_name(path: Path) -> list[str]:
    """Return the parts of a name: text, number, text, and so on.

    The number of a recording of GoPro is a text.
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
    """Return the parts of a name, with numbers as such: img_9 comes before img_10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.stem)]
