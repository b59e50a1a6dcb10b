"""What is released installs and runs: wheel and source distribution, with each Python that is supported."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hiltest import __version__

ROOT = Path(__file__).parents[1]
WALL_LIMIT_S = 600.0  # for an installation that takes half a minute where nothing else runs
PYTHONS = ("3.11", "3.12", "3.13")


def run(*command: str | Path, cwd: Path) -> str:
    """Return what a command prints; its output is shown where it fails."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("HIL_", "PYTHON"))}
    done = subprocess.run(
        command, cwd=cwd, env=kept, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, timeout=WALL_LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    return done.stdout


def interpreter(version: str) -> Path:
    """Return a Python of this version, on the path or of pyenv; there is no package of all of them to install."""
    named = f"python{version}"
    found = shutil.which(named)
    for each in ([Path(found)] if found else []) + sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/{named}")):
        if subprocess.run([each, "-m", "venv", "-h"], capture_output=True, check=False).returncode == 0:
            return each
    pytest.skip(f"no {named} here")


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The source distribution, and the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--outdir", folder, ROOT, cwd=folder)
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return {"wheel": wheel, "source": source}


@pytest.mark.parametrize(
    "version", [pytest.param(each, marks=[] if each == PYTHONS[0] else pytest.mark.ci) for each in PYTHONS]
)
def test_wheel_and_source_install_and_run(version: str, distributions: dict[str, Path], tmp_path: Path) -> None:
    run(interpreter(version), "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    here = tmp_path / "venv" / "bin"
    verdicts = {}
    for kind, file in distributions.items():
        once_more = ["--force-reinstall", "--no-deps"] if verdicts else []
        run(here / "pip", "install", "--quiet", *once_more, file, cwd=tmp_path)
        run(here / "pip", "check", cwd=tmp_path)
        assert run(here / "hiltest", "--version", cwd=tmp_path).split()[-1] == __version__
        said = run(here / "hiltest", "run", "--poses", "level", cwd=tmp_path)
        verdicts[kind] = next(line for line in said.splitlines() if line.startswith("PASS. "))
    assert verdicts["wheel"] == verdicts["source"]
