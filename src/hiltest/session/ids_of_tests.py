"""What the record calls a test."""

from __future__ import annotations

import os
from pathlib import Path

GROUP = "hil"
"""What pytest-xdist calls the tests that it keeps together."""

# Folders of suites: a bench's own, and the packaged ones.
_SUITES = (("hil", "suites"), ("bench", "suites"))


def id_in_record(nodeid: str, root: Path) -> str:
    """Return the id of a test for the record: for a suite it does not depend on where pytest was started.

    Parameters
    ----------
    nodeid : str
        As pytest has it, with the group that pytest-xdist puts behind it.
    root : Path
        That its file is relative to.
    """
    nodeid = nodeid.removesuffix(f"@{GROUP}")
    file, colons, rest = nodeid.partition("::")
    parts = Path(os.path.normpath(root / file)).parts
    for index in range(len(parts) - 1, 1, -1):
        if parts[index - 2 : index] in _SUITES:
            return "/".join(parts[index:]) + colons + rest
    return nodeid
