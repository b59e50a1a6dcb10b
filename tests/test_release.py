"""What is released installs and runs: wheel and source distribution, with each Python that is supported."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from elftools.elf.elffile import ELFFile
from elftools.elf.gnuversions import GNUVerNeedSection

from hiltest import __version__
from hiltest.virtual.core.c_library import RELEASE_GLIBC

ROOT = Path(__file__).parents[1]
WALL_LIMIT_S = 600.0  # for an installation that takes half a minute where nothing else runs
PYTHONS = ("3.11", "3.12", "3.13")


def run(*command: str | Path, cwd: Path) -> str:
    """Return what a command prints; its output is shown where it fails."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("HIL_", "PYTHON"))}
    done = subprocess.run(
        command,
        cwd=cwd,
        env=kept,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=WALL_LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def interpreter(version: str) -> Path:
    """Return a Python of this version, on the path or of pyenv; there is no package of all of them to install."""
    named = f"python{version}"
    result = shutil.which(named)
    for item in ([Path(result)] if result else []) + sorted(
        Path.home().glob(f".pyenv/versions/{version}.*/bin/{named}")
    ):
        if subprocess.run([item, "-m", "venv", "-h"], capture_output=True, check=False).returncode == 0:
            return item
    pytest.skip(f"no {named} here")


def build_release(folder: Path, architecture: str = "") -> tuple[Path, Path]:
    """Build the source distribution, and from it the wheel for an architecture, or quickly for this machine alone."""
    build = (sys.executable, "-m", "build", "--outdir", folder, ROOT)
    run("env", f"HILTEST_WHEEL_ARCH={architecture}", *build, cwd=folder)
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, source


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    wheel, source = build_release(tmp_path_factory.mktemp("dist"))
    return {"wheel": wheel, "source": source}


@pytest.mark.ci  # tox installs the wheel for all other tests
@pytest.mark.parametrize("version", PYTHONS)
def test_wheel_and_source_install_and_run(version: str, distributions: dict[str, Path], tmp_path: Path) -> None:
    run(interpreter(version), "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    place = tmp_path / "venv" / "bin"
    verdicts = {}
    for kind, file in distributions.items():
        once_more = ["--force-reinstall", "--no-deps"] if verdicts else []
        run(place / "pip", "install", "--quiet", *once_more, file, cwd=tmp_path)
        run(place / "pip", "check", cwd=tmp_path)
        assert run(place / "hiltest", "--version", cwd=tmp_path).split()[-1] == __version__
        answer = run(place / "hiltest", "run", "--poses", "level", cwd=tmp_path)
        verdicts[kind] = next(line for line in answer.splitlines() if line.startswith("PASS. "))
    assert verdicts["wheel"] == verdicts["source"]


def needed_glibc(library: Path) -> tuple[int, ...]:
    """Return the newest version of glibc that a library needs a symbol of."""
    with library.open("rb") as file:
        sections = [section for section in ELFFile(file).iter_sections() if isinstance(section, GNUVerNeedSection)]
        names = [symbol.name for section in sections for _, symbols in section.iter_versions() for symbol in symbols]
    return max(tuple(map(int, re.findall(r"\d+", name))) for name in names if name.startswith("GLIBC_"))


# Executes two instructions at 0x1000, and prints what the core has counted and computed.
PROGRAM = """
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include "machine.h"

int main(void)
{
    struct machine *machine = machine_create(false);
    const uint8_t code[] = { 0x2A, 0x20, 0x40, 0x43, 0xFE, 0xE7 }; /* movs r0, #42; muls r0, r0; b . */
    struct core *core = machine_core(machine);
    machine_add_memory(machine, 0x1000, 0x1000, false);
    machine_write(machine, 0x1000, sizeof code, code);
    core->thumb = 1;
    core->r[15] = 0x1000;
    core->deadline = 100;
    int32_t reason = machine_run(machine);
    printf("%d %u %lld\\n", reason, (unsigned)core->r[0], (long long)core->instructions);
    machine_destroy(machine);
    return 0;
}
"""


@pytest.mark.ci
def test_the_core_of_a_wheel_for_arm64_runs_there_with_an_old_glibc(
    require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    wheel, _ = build_release(tmp_path, "aarch64")
    assert wheel.name.endswith("-py3-none-manylinux_2_17_aarch64.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    libraries = sorted(tmp_path.rglob("*.so"))
    assert [library.stem for library in libraries] == ["instances_kernel", "core"]
    assert all(needed_glibc(library) <= RELEASE_GLIBC for library in libraries)
    core, program = libraries[1], tmp_path / "program"
    program.with_suffix(".c").write_text(PROGRAM, encoding="ascii")
    compiler = require_tool("aarch64-linux-gnu-gcc")
    headers = ROOT / "src" / "hiltest" / "virtual" / "core"
    options = (f"-I{headers}", f"-Wl,-rpath,{core.parent}", "-o", program)
    run(compiler, *options, program.with_suffix(".c"), core, cwd=tmp_path)
    printed = run(require_tool("qemu-aarch64"), "-L", "/usr/aarch64-linux-gnu", program, cwd=tmp_path)
    stop_loop = 4
    assert printed.split() == [str(stop_loop), str(42 * 42), "2"]
