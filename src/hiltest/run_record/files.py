"""Names of the files of a run and of a campaign, and a writer that writes a file as a whole or not at all."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.json_files import json_text

RUN_FILE = "run.json"
REPORT_FILE = "report.html"
MARKDOWN_FILE = "report.md"
COVERAGE_FILE = "lcov.info"
"""Coverage of one seed of a campaign."""
RECORD_FILES = (RUN_FILE, REPORT_FILE, MARKDOWN_FILE, "junit.xml")
SEED_FOLDERS = "seed-*"
"""Folders of a campaign, each with the record of one seed."""
SEEDS_FILE = "seeds.json"
"""Summary of a campaign as data, written after all its seeds have run."""
CAMPAIGN_FILE = "seeds.md"
BOARDS_FILE, BOARDS_PAGE, BOARDS_MARKDOWN, BOARDS_TABLE = "boards.json", "boards.html", "boards.md", "boards.csv"
"""Summary of several boards."""
OLDER_FOLDER = "against"
"""Folder of the older firmware's record, inside the folder of the newer one's."""
UNFINISHED = ".unfinished"
"""Suffix of a file that is being written."""


def write_atomically(path: Path, text: str) -> Path:
    """Write a file so that a reader sees either the old text or the whole new one.

    A regular file, or a new name, is written under a temporary name beside it and moved into place; permissions are
    kept. A link is followed. A device, a pipe or an open file (``/dev/stdout``) is not replaced: the text is written to
    it. A lone surrogate, as in a file name that is not UTF-8, becomes a question mark.

    Raises
    ------
    OSError
        If it cannot be written; the old file is then unchanged.
    """
    target = _replaceable(path)
    if target is None:
        with path.open("a", encoding="utf-8", errors="replace") as file:  # so that an open file keeps its content
            file.write(text)
        return path
    # The temporary name is specific to this process, so that two writers of one file do not collide.
    unfinished = target.with_name(f"{target.name}.{os.getpid()}{UNFINISHED}")
    try:
        with unfinished.open("w", encoding="utf-8", errors="replace") as file:
            if target.exists():
                os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(target)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
    return path


def write_asked_for(path: Path, text: str) -> None:
    """Write a file that the user requested.

    Raises
    ------
    ConfigError
        If it cannot be written.
    """
    try:
        write_atomically(path, text)
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot write {path}: {reason}; name another file") from error


def write_document(path: Path, document: object, schema: str | None = None) -> None:
    """Write a document as JSON, like `write_asked_for`; `schema` as in `json_text`."""
    write_asked_for(path, json_text(document, schema) + "\n")


def _replaceable(path: Path) -> Path | None:
    """Return the regular file or new name that a path leads to; None if the target must not be replaced."""
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(path.stat().st_mode):
            return None
    while path.is_symlink():  # a loop is impossible, since stat rejects it
        path = path.parent / path.readlink()
        if path.parent.resolve().is_relative_to("/proc"):
            return None  # an open file of a process, which would not see a new file
    return path
