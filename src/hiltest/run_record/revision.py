"""The sources that a run is made for: the user's label, and the commit that a CI job has checked out.

This module asks no repository. The commit of the working folder is that of the firmware only if nothing is edited and
the ELF was built there; a check walks the whole tree, and git may start programs that the tree's settings name.
The user can state it instead: ``--label "$(git describe --always --dirty)"``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

from hiltest.run_record.comparison import Revision

_COMMIT = re.compile(r"[0-9a-f]{7,64}")
_LONGEST_BRANCH = 200


def revision_of(label: str | None, environment: Mapping[str, str] = os.environ) -> Revision | None:
    """Return the sources that a run is made for; None if neither label nor job names them.

    Parameters
    ----------
    label
        Label of the user. If it is empty instead of None, the run does not belong to the job's commit.
    environment
        Environment; a job of GitHub Actions has ``GITHUB_SHA`` and ``GITHUB_REF_NAME``. Values that are no commit or
        no name of a branch are ignored.
    """
    if label == "":
        return None
    commit, branch = environment.get("GITHUB_SHA", ""), environment.get("GITHUB_REF_NAME", "")
    revision = Revision(
        commit=commit if _COMMIT.fullmatch(commit) else "",
        branch=branch if branch.isprintable() and len(branch) <= _LONGEST_BRANCH else "",
        label=label or "",
    )
    return None if revision == Revision() else revision
