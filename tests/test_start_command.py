"""`hiltest start`: from an ELF in a repository to files with which CI judges every change."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from hiltest.boards import default_firmware
from hiltest.rig.bench_files import shipped

pytestmark = pytest.mark.slow

FIRMWARE = default_firmware().parent
Start = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Return a function that runs `hiltest start` in a repository without any file."""

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "hiltest", "start", *words],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )

    subprocess.run(["git", "init", "-q", "-b", "trunk", str(tmp_path)], check=True, timeout=60)
    return run


def files_of(folder: Path) -> set[str]:
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and path.relative_to(folder).parts[0] not in (".git", "hil-out")
    }


@pytest.mark.ci
def test_firmware_with_lines_of_its_own_gets_a_rig_and_a_workflow_that_passes(tmp_path: Path, start: Start) -> None:
    shutil.copy(FIRMWARE / "compass-lines.elf", tmp_path / "my compass.elf")
    (tmp_path / ".gitignore").write_text("*.elf", encoding="utf-8")
    done = start("--json")
    assert done.returncode == 0, done.stderr
    files, missing, owner = (
        done.stderr.index(text)
        for text in (
            "Commit these files",
            "The workflow cannot find my compass.elf: git ignores it",
            "Replace OWNER in",
        )
    )
    assert done.stderr.index("hiltest baseline save") < files < missing < owner
    written = {"hil/rigs/my-compass.toml", "hil/baselines/my-compass.json", ".github/workflows/hiltest.yml"}
    assert files_of(tmp_path) == {"my compass.elf", ".gitignore", *written}
    document = json.loads(done.stdout)
    assert (document["firmware"], document["exit_code"]) == ("my compass.elf", 0)
    assert {document["rig"], document["baseline"], document["workflow"]} == written
    assert (tmp_path / ".gitignore").read_text(encoding="utf-8") == "*.elf\nhil-out/\n"
    workflow = yaml.safe_load((tmp_path / ".github/workflows/hiltest.yml").read_text(encoding="utf-8"))
    assert workflow[True]["push"]["branches"] == ["trunk"]
    *_, action = workflow["jobs"]["virtual-board"]["steps"]
    options = action["with"]
    assert options.pop("comment-token") == "${{ github.token }}"
    named = [word for name, value in options.items() for word in (f"--{name}", value)]
    command = [sys.executable, "-m", "hiltest", "run", *named]
    judged = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert judged.returncode == 0, judged.stdout
    assert "(against hil/baselines/my-compass.json): PASS" in judged.stdout
    before = (tmp_path / ".github/workflows/hiltest.yml").read_bytes()
    shutil.rmtree(tmp_path / ".git")
    repeated = start("--action", "owner/other@v2")
    assert "hil/rigs/my-compass.toml exists and is used" in repeated.stdout
    assert "Commit these files" not in repeated.stdout
    assert "Replace OWNER" not in repeated.stdout
    assert ".github/workflows/hiltest.yml exists and stays as it is" in repeated.stdout
    assert (tmp_path / ".github/workflows/hiltest.yml").read_bytes() == before


@pytest.mark.parametrize(
    ("elves", "words", "complaint"),
    [
        (["a.elf"], ["--action", "other"], "--action other is not OWNER/NAME@REF"),
        ([], [], "has no file *.elf; build your firmware"),
        (["a.elf", "build/b.elf"], [], "several ELFs: a.elf, build/b.elf; name one: hiltest start a.elf"),
        (["a.elf"], ["gone.elf"], "gone.elf does not exist"),
        (["${{ github.token }}.elf"], [], "GitHub evaluates ${{ in a workflow"),
        (["a.elf"], ["../outside.elf"], "run hiltest start in the repository that builds it"),
        (["a.elf"], [], "not a complete ELF file"),
    ],
)
def test_a_folder_without_one_firmware_is_refused_and_nothing_is_written(
    tmp_path: Path, start: Start, elves: list[str], words: list[str], complaint: str
) -> None:
    (tmp_path.parent / "outside.elf").write_bytes(b"none")
    for name in elves:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"none")
    done = start(*words)
    assert done.returncode == 4
    assert complaint in done.stderr
    assert files_of(tmp_path) == set(elves)


def test_the_end_of_the_input_interrupts_the_dialogue(tmp_path: Path) -> None:
    for name in ("a.elf", "b.elf"):
        (tmp_path / name).write_bytes(b"none")
    keyboard, terminal = os.openpty()
    os.write(keyboard, b"\x04")
    command = [sys.executable, "-m", "hiltest", "start"]
    done = subprocess.run(
        command, cwd=tmp_path, stdin=terminal, stdout=terminal, stderr=subprocess.PIPE, check=False, timeout=60
    )
    os.close(terminal)
    os.close(keyboard)
    assert (done.returncode, done.stderr.endswith(b"interrupted\n")) == (2, True)
    assert files_of(tmp_path) == {"a.elf", "b.elf"}


def test_a_rig_for_a_real_board_gets_no_workflow(tmp_path: Path, start: Start) -> None:
    shutil.copy(FIRMWARE / "compass-lines.elf", tmp_path / "mine.elf")
    rig = tmp_path / "hil" / "rigs" / "mine.toml"
    rig.parent.mkdir(parents=True)
    shutil.copy(shipped() / "rigs" / "frdm-k64f.toml", rig)
    done = start()
    assert done.returncode == 0, done.stderr
    assert "Run it on its own board: hiltest run --rig hil/rigs/mine.toml --port PORT." in done.stdout
    assert files_of(tmp_path) == {"mine.elf", "hil/rigs/mine.toml"}
