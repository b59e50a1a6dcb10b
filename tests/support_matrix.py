"""The main job with the oldest and the newest version of every dependency, on every supported Python.

    python -m tests.support_matrix [--only N]

makes an environment for each cell, runs the full set of tests in it, and compares every measured number with the newest
versions on this Python. The oldest versions are the floors in pyproject.toml, or the first with a wheel for the Python.
``--only N`` chooses one of the cells by a number, such as a commit's; otherwise every Python must be there.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
VERSIONS = {"oldest": "lowest-direct", "newest": "highest"}


def find_python(version: str) -> str | None:
    """Return the path of an interpreter: beside this one, as pyenv has them, or on PATH."""
    siblings = Path(sys.base_prefix).parent.glob(f"{version}.*/bin/python{version}")
    return next(map(str, siblings), None) or shutil.which(f"python{version}")


def uv(*words: str) -> None:
    """Run uv with the package index of pip; exit if it fails."""
    index = {"UV_DEFAULT_INDEX": "PIP_INDEX_URL", "UV_INDEX": "PIP_EXTRA_INDEX_URL", "UV_FIND_LINKS": "PIP_FIND_LINKS"}
    from_pip = {name: os.environ[of_pip] for name, of_pip in index.items() if of_pip in os.environ}
    subprocess.run([sys.executable, "-m", "uv", *words], check=True, cwd=ROOT, env=os.environ | from_pip, timeout=900)


def numbers_with(folder: Path, wheel: Path, python: str, resolution: str) -> dict[tuple[str, str], Any]:
    """Return what the main job measures in an environment of its own, by measurement and test."""
    interpreter = str(folder / "bin" / "python")
    uv("venv", "--quiet", "--python", python, str(folder))
    install = ("pip", "install", "--quiet", "--python", interpreter)
    uv(*install, "--only-binary", ":all:", "--resolution", resolution, "--requirements", "pyproject.toml")
    uv(*install, "--no-deps", str(wheel))
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("HIL_", "PYTHON"))}
    command = [interpreter, "-m", "hiltest", "run", "--suite", "full", "--out", "out"]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=900
    )
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}exit code {done.returncode}")
    record = json.loads((folder / "out" / "run.json").read_text(encoding="utf-8"))
    return {(item["name"], item["test"]): item["value"] for item in record["measurements"] if not item["volatile"]}


def main() -> None:
    """Compare the cells; exit with 1 if a number differs."""
    parser = argparse.ArgumentParser(description="Run the main job with other versions, and compare its numbers.")
    parser.add_argument("--only", type=int, metavar="N", help="Try one cell: number N, counted in a circle.")
    only = parser.parse_args().only
    pythons = {version: find_python(version) for version in PYTHONS}
    missing = [version for version, path in pythons.items() if path is None]
    for version in missing:
        print(f"Python {version}: not found here, so not tried")
    cells = list(product([version for version in PYTHONS if version not in missing], VERSIONS))
    if only is not None:
        cells = [cells[only % len(cells)]]
    differing = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        uv("build", "--quiet", "--wheel", "--out-dir", temporary)
        (wheel,) = folder.glob("*.whl")
        here = numbers_with(folder / "here", wheel, sys.executable, VERSIONS["newest"])
        for version, age in cells:
            numbers = numbers_with(folder / f"{version}-{age}", wheel, str(pythons[version]), VERSIONS[age])
            others = [key for key in here.keys() | numbers.keys() if here.get(key) != numbers.get(key)]
            print(f"Python {version}, {age} versions: {len(numbers)} numbers, {len(others)} differ", flush=True)
            for name, test in others:
                print(f"  {name}: {numbers.get((name, test))} instead of {here.get((name, test))} in {test}")
            differing += len(others)
    sys.exit(1 if differing or (missing and only is None) else 0)


if __name__ == "__main__":
    main()
