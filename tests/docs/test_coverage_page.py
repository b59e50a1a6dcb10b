"""The page about coverage: its commands run, and leave what it says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.virtual.coverage.lcov import Coverage, from_lcov

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "coverage.md").read_text(encoding="utf-8")
(RUN, GENHTML), (CAMPAIGN,) = (block.splitlines() for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S))
ONE_TEST = ("--", "-k", "identity")


def run(command: str, folder: Path) -> str:
    done = run_module(*shlex.split(command), *ONE_TEST, folder=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def read(path: Path) -> Coverage:
    return from_lcov(path.read_text(encoding="utf-8"), str(path))


@pytest.mark.slow
def test_a_campaign_adds_up_its_seeds(tmp_path: Path) -> None:
    answer = run(CAMPAIGN.replace("1..8", "1..2"), tmp_path)
    whole = Coverage()
    for seed in (1, 2):
        whole.add(read(tmp_path / "hil-out" / f"seed-{seed:04d}" / "lcov.info"))
    assert read(tmp_path / "lcov.info") == whole
    assert whole.files["firmware_stub/app/main.c"].functions["main"][1] == 2
    assert f"Coverage: {whole.lines.hit} of {whole.lines.total} lines (" in answer


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("genhtml") is None, reason="of Debian's package lcov, which nothing else here needs")
def test_genhtml_makes_pages_of_it(tmp_path: Path) -> None:
    (tmp_path / "firmware_stub").symlink_to(ROOT / "firmware_stub")
    run(RUN, tmp_path)
    done = subprocess.run(shlex.split(GENHTML), cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60)
    result = read(tmp_path / "lcov.info")
    assert f"({result.lines.hit} of {result.lines.total} lines)" in done.stdout
    assert (tmp_path / "html" / "index.html").is_file()


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.parametrize(("suite", "column"), [("gate", 0), ("full", 1)])
def test_what_the_suites_walk_is_as_the_page_has_it(tmp_path: Path, suite: str, column: int) -> None:
    (tmp_path / "firmware_stub").symlink_to(ROOT / "firmware_stub")
    command = [sys.executable, "-m", "hiltest", "run", "--suite", suite, "--coverage", "lcov.info"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=1800
    )
    assert done.returncode == 0, done.stdout + done.stderr
    result = read(tmp_path / "lcov.info")
    for case, share in (
        ("lines", result.lines),
        ("functions", result.functions),
        ("branches both ways", result.branches),
    ):
        (cells,) = re.findall(rf"^\| {case} \| (\d+) of (\d+) .*? \| (\d+) of (\d+) ", PAGE, re.M)
        assert share == tuple(map(int, cells[2 * column :][:2])), f"{case} in the {suite} set"
    if suite == "full":  # what the page promises of it
        assert result.lines.hit >= 0.9 * result.lines.total
        assert result.branches.hit >= 0.55 * result.branches.total
