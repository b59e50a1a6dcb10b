"""Paths from names in files or from other machines: one guard, which refuses names that lead elsewhere."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from hiltest.errors import ConfigError

_LONGEST_BYTES = 200
# Device names of Windows, with any suffix.
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?")


def path_in(folder: Path, name: str, *, remedy: str) -> Path:
    """Return the path of a file or folder directly in a folder.

    Raises
    ------
    ConfigError
        If the name is empty, dots, too long, reserved on some system, has a separator, a colon or a control character,
        ends in a dot or a blank, or is a link in the folder.
    """
    reason = ""
    if not name or set(name) == {"."}:
        reason = "leads to another folder" if name else "is empty"
    elif re.search(r"[/\\:\x00-\x1f\x7f]", name):
        reason = "has a separator or a control character"
    elif len(name.encode("utf-8", errors="replace")) > _LONGEST_BYTES:
        reason = f"is longer than {_LONGEST_BYTES} bytes"
    elif _RESERVED.fullmatch(name) or name[-1] in ". ":
        reason = "is not a file name on every system"
    elif (folder / name).is_symlink():
        reason = f"is a link in {folder}"
    if reason:
        raise ConfigError(f"{name[:_LONGEST_BYTES]!r} {reason}, and cannot name a file: {remedy}")
    return folder / name


def path_below(folder: Path, name: str, *, remedy: str) -> Path:
    """Return the path of a file below a folder, from a name with slashes; the errors are those of `path_in`."""
    for part in PurePosixPath(name).parts or ("",):
        folder = path_in(folder, part, remedy=remedy)
    return folder
