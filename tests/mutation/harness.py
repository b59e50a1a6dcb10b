"""Make each mistake in a copy of the package, and see whether the quick tests find it.

    python -m tests.mutation.harness [WORD ...]

The tests of the module come first, all quick ones only where those stay green. Ends with 1 when less than 95 % are
found.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_name("harness.toml")
FOUND_AT_LEAST = 0.95
WALL_LIMIT_S = 1200  # all quick tests take three minutes


def main() -> int:
    """Run, and print the score."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD")
    words = parser.parse_args().words
    every = tomllib.loads(FILE.read_text(encoding="utf-8"))
    chosen = [
        (file, edit, every[file]["tests"])
        for file in every
        for edit in every[file]["edit"]
        if not words or any(word in f"{file} {edit['new']}" for word in words)
    ]
    survivors = []
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "src"
        shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
        for number, (file, edit, tests) in enumerate(chosen, start=1):
            result = is_found(source, file, edit, tests)
            if not result:
                survivors.append(f"{file}: {edit['old']!r} -> {edit['new']!r}")
            word = "found   " if result else "SURVIVED"
            print(f"[{number:2}/{len(chosen)}] {word} {file}: {edit['new']!r}", flush=True)
    share = 1.0 - len(survivors) / max(len(chosen), 1)
    print(f"{len(chosen)} mistakes: {share:.1%} found by the quick tests (at least {FOUND_AT_LEAST:.0%})")
    print("\n".join(f"survived: {survivor}" for survivor in survivors))
    return 0 if share >= FOUND_AT_LEAST else 1


def is_found(source: Path, file: str, edit: dict[str, Any], tests: list[str]) -> bool:
    """Make one mistake, run the tests, and put the file back."""
    path = source / "hiltest" / file
    text = path.read_text(encoding="utf-8")
    assert text.count(edit["old"]) == 1, f"{file}: {edit['old']!r} is there {text.count(edit['old'])} times"
    path.write_text(text.replace(edit["old"], edit["new"]), encoding="utf-8")
    try:
        return is_red(source, tests) or is_red(source, ["tests"])
    finally:
        path.write_text(text, encoding="utf-8")


def is_red(source: Path, tests: list[str]) -> bool:
    """Run quick tests with the package of a folder, and say whether one of them is red."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", "-n", "2"]
    environment = os.environ | {"PYTHONPATH": str(source), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [*command, *tests], cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=WALL_LIMIT_S
    )
    assert done.returncode in (0, 1, 2), done.stdout + done.stderr
    return done.returncode != 0


if __name__ == "__main__":
    sys.exit(main())
