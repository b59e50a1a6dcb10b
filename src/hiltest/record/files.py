"""Files that a run and a campaign leave: their names, and how one is written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

RUN_FILE = "run.json"
REPORT_FILE = "report.html"
RECORD_FILES = (RUN_FILE, REPORT_FILE, "report.md", "junit.xml")
SEED_FOLDERS = "seed-*"
"""Folders of a campaign, each with the record of one seed."""
SEEDS_FILE = "seeds.json"
"""Summary of a campaign as data; written when all its seeds have run."""
CAMPAIGN_FILE = "seeds.md"
OLDER_FOLDER = "against"
"""Folder of the older firmware's record, inside the folder of the newer one's."""
UNFINISHED = ".unfinished"
"""Suffix of a file that is being written."""


def write_atomically(path: Path, text: str) -> Path:
    """Write `text` beside `path`, then move it there: whoever opens it sees the old text or the new, and all of it.

    A lone surrogate, as of a file's name that is no UTF-8, becomes a question mark.
    """
    # Of this process alone: two that write one file take nothing from each other.
    unfinished = path.with_name(f"{path.name}.{os.getpid()}{UNFINISHED}")
    try:
        with unfinished.open("w", encoding="utf-8", errors="replace") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
    return path
