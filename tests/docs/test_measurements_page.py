"""docs/measurements.md is what its script writes from the catalogue and the default rig."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_the_one_that_its_script_writes(tmp_path: Path) -> None:
    script = tmp_path / "measurements.py"
    script.write_bytes((DOCS / "measurements.py").read_bytes())
    subprocess.run([sys.executable, script], check=True, cwd=DOCS.parent, timeout=60)
    assert (tmp_path / "measurements.md").read_text(encoding="utf-8") == (
        (DOCS / "measurements.md").read_text(encoding="utf-8")
    ), "write it anew: python docs/measurements.py"
