"""The sources that a run is made for: the user's label, and the commit that a job has checked out.

No repository is asked. The commit of the working folder is that of the firmware only where nothing is edited, and the
ELF was built there; to find out takes a walk over the whole tree, in which git may start what the tree's settings name.
Whoever knows says so: ``--label "$(git describe --always --dirty)"``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

from hiltest.record.comparison import Revision

_COMMIT = re.compile(r"[0-9a-f]{7,64}")
_LONGEST_BRANCH = 200


def revision_of(label: str | None, environment: Mapping[str, str] = os.environ) -> Revision | None:
    """Return the sources that a run is made for; None where neither label nor job names them.

    Parameters
    ----------
    label
        What its user calls it. Empty, and not None: the run is not of the job's commit, nothing is to be noted.
    environment
        A job of GitHub Actions has ``GITHUB_SHA`` and ``GITHUB_REF_NAME``. What is no commit or no name of a branch
        is left out.
    """
    if label == "":
        return None
    commit, branch = environment.get("GITHUB_SHA", ""), environment.get("GITHUB_REF_NAME", "")
    found = Revision(
        commit=commit if _COMMIT.fullmatch(commit) else "",
        branch=branch if branch.isprintable() and len(branch) <= _LONGEST_BRANCH else "",
        label=label or "",
    )
    return None if found == Revision() else found
