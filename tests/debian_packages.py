"""Programs of Debian's packages, for tests: none of them is in the repository."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest


def packaged_file(package: str, name: str, folder: Path, require_tool: Callable[[str], str]) -> Path:
    """Return a file of a package; skip the test if the package cannot be downloaded.

    Parameters
    ----------
    name
        Path within the package. The folder that HILTEST_PROGRAMS names may have the file as well, by the name of the
        package with the suffix of the file.
    folder
        Empty folder for the content of the package.
    require_tool
        Finds a program, or skips the test.
    """
    programs = os.environ.get("HILTEST_PROGRAMS")
    if programs and (own := Path(programs, package).with_suffix(Path(name).suffix).resolve()).is_file():
        return own
    apt, dpkg = require_tool("apt-get"), require_tool("dpkg-deb")
    fetched = subprocess.run([apt, "download", package], cwd=folder, capture_output=True, text=True, timeout=120)
    if fetched.returncode:
        pytest.skip(f"apt-get cannot download {package}: {fetched.stderr.strip()[-200:]}")
    (deb,) = folder.glob("*.deb")
    subprocess.run([dpkg, "-x", deb, folder], check=True, timeout=60)
    return folder / name
