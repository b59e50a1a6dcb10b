"""The workflow of the page about CI: its steps run as they stand, red where something got worse, and need no token."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from hiltest import __version__

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
(WORKFLOW_TEXT,) = re.findall(r"^```yaml\n(.*?)^```", PAGE, re.M | re.S)
WORKFLOW = yaml.safe_load(WORKFLOW_TEXT)
SET_UP, WHEN_WORSE = (block.splitlines() for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S))
(JOB,) = WORKFLOW["jobs"].values()
BASELINE = Path("hil") / "baselines" / "virtual-k64f.json"

# The one line of the workflow that is not run as it stands: hiltest is the one under test, which is installed.
INSTALL = f"python -m pip install hiltest=={__version__}"

WALL_LIMIT_S = 300.0  # for runs that take some 15 s on a machine of their own


@dataclass(frozen=True)
class Ran:
    """What became of a step that is a command."""

    code: int
    said: str
    summary: str


def environment(folder: Path, summary: Path | None = None) -> dict[str, str]:
    """Return what a runner has, with the hiltest under test; its own settings are none of the workflow's."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("HIL_", "GITHUB_"))}
    kept["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{kept['PATH']}"
    job = {"CI": "true", "GITHUB_ACTIONS": "true", "GITHUB_STEP_SUMMARY": str(summary)} if summary else {}
    return kept | job | {"HOME": str(folder)}


def sh(command: str, folder: Path, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run a line as GitHub's shell does."""
    return subprocess.run(
        ["bash", "-e", "-c", command], cwd=folder, capture_output=True, text=True, check=False, timeout=WALL_LIMIT_S,
        stdin=subprocess.DEVNULL, **{"env": environment(folder)} | more,
    )  # fmt: skip


def run_job(folder: Path) -> dict[str, Ran]:
    """Run the steps of the job that are commands in a checked-out folder; those behind a red one as `if` says."""
    ran: dict[str, Ran] = {}
    for number, step in enumerate(JOB["steps"]):
        red = any(each.code for each in ran.values())
        if "run" not in step or (red and "!cancelled()" not in step.get("if", "")):
            continue
        summary = folder.parent / f"summary-{number}.md"  # one of its own a step, as GitHub has it
        command = "true" if step["run"] == INSTALL else step["run"]
        done = sh(command, folder, env=environment(folder, summary))
        text = summary.read_text(encoding="utf-8") if summary.exists() else ""
        ran[step["name"]] = Ran(done.returncode, done.stdout + done.stderr, text)
    return ran


def checked_out(folder: Path, baseline: Path) -> Path:
    """Return a repository as it is after the page's first command, with a committed baseline."""
    folder.mkdir()
    done = sh(SET_UP[0], folder)
    assert done.returncode == 0, done.stderr
    (folder / BASELINE).parent.mkdir(exist_ok=True)
    shutil.copy(baseline, folder / BASELINE)
    return folder


def the_run(ran: dict[str, Ran]) -> Ran:
    (name,) = [step["name"] for step in JOB["steps"] if step.get("run", "").startswith("hiltest run")]
    return ran[name]


@pytest.fixture(scope="module")
def green(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Ran]]:
    """What the job does with the baseline that hiltest's own CI judges by."""
    folder = checked_out(tmp_path_factory.mktemp("green") / "repository", ROOT / BASELINE)
    return folder, run_job(folder)


@pytest.fixture(scope="module")
def saved(green: tuple[Path, dict[str, Ran]]) -> Path:
    """The baseline that the page's third command saves of that run."""
    folder, _ = green
    done = sh(SET_UP[2].replace(str(BASELINE), "saved.json"), folder)
    assert done.returncode == 0, done.stderr
    return folder / "saved.json"


@pytest.fixture(scope="module")
def red(tmp_path_factory: pytest.TempPathFactory, saved: Path) -> tuple[Path, dict[str, Ran]]:
    """What the job does for a firmware that needs one cycle more than the baseline has."""
    folder = checked_out(tmp_path_factory.mktemp("red") / "repository", saved)
    content = json.loads(saved.read_text(encoding="utf-8"))
    (row,) = [each for each in content["measurements"] if each["name"] == "cycles.direct.total"]
    row["values"] = [value - 1 for value in row["values"]]
    (folder / BASELINE).write_text(json.dumps(content), encoding="utf-8")
    return folder, run_job(folder)


def commands() -> Iterator[str]:
    yield from (step["run"] for step in JOB["steps"] if "run" in step)


def test_only_the_installation_is_replaced() -> None:
    assert [each for each in commands() if "pip" in each] == [INSTALL]


def test_the_job_is_green_for_the_packaged_firmware_and_shows_its_report(green: tuple[Path, dict[str, Ran]]) -> None:
    folder, ran = green
    assert {name: each.code for name, each in ran.items()} == dict.fromkeys(ran, 0), the_run(ran).said
    run = the_run(ran)
    assert run.summary.startswith("# PASS\n")
    assert "## Against the baseline" in run.summary
    assert "::error" not in run.said
    record = json.loads((folder / "hil-out" / "run.json").read_text(encoding="utf-8"))
    assert record["comparison"]["obstacles"] == []
    assert json.loads((folder / "hil-out" / "bmf.json").read_text(encoding="utf-8"))


def test_one_cycle_more_is_red_with_the_reason_in_summary_and_annotation(red: tuple[Path, dict[str, Ran]]) -> None:
    _, ran = red
    run = the_run(ran)
    assert run.code == 21, run.said
    assert "| worse | cycles.direct.total |" in run.summary
    (annotation,) = [line for line in run.said.splitlines() if line.startswith("::")]
    assert annotation.startswith("::error title=hiltest%3A regression::")
    assert "cycles.direct.total" in annotation


def test_a_red_job_still_keeps_its_record(red: tuple[Path, dict[str, Ran]]) -> None:
    folder, ran = red
    (upload,) = [step for step in JOB["steps"] if step.get("uses", "").startswith("actions/upload-artifact@")]
    assert "!cancelled()" in upload["if"]
    kept = {path.name for path in (folder / upload["with"]["path"]).iterdir()}
    assert {"run.json", "report.html", "report.md", "junit.xml", "bmf.json"} <= kept
    assert len([step for step in JOB["steps"] if "run" in step]) == len(ran)


def test_the_baseline_that_the_page_saves_is_the_committed_one_of_the_same_seed(saved: Path) -> None:
    assert SET_UP[1] == "hiltest run", "as the job does, but for the baseline that there is none yet"
    ours, committed = (json.loads(path.read_text(encoding="utf-8")) for path in (saved, ROOT / BASELINE))
    assert ours["seeds"] == [1]
    of_seed_1 = {each["name"]: each["values"][0] for each in committed["measurements"]}
    assert {each["name"]: each["values"][0] for each in ours["measurements"]} == of_seed_1


def test_a_change_is_accepted_by_name_and_the_job_is_green_again(red: tuple[Path, dict[str, Ran]]) -> None:
    folder, _ = red
    run, update, diff = WHEN_WORSE
    assert shlex.split(run) in [shlex.split(each) for each in commands()], "which the job has run"
    assert diff.startswith("git diff hil/")
    done = sh(update, folder)
    assert done.returncode == 0, done.stderr
    assert "for 0.2 deg less at the poles" in (folder / BASELINE).read_text(encoding="utf-8")
    compared = sh(f"hiltest compare {BASELINE} hil-out", folder)
    assert compared.returncode == 0, compared.stdout


def test_the_workflow_needs_no_token_and_runs_nothing_that_a_stranger_names() -> None:
    triggers = WORKFLOW[True]  # YAML 1.1 reads the key "on" as a truth
    assert set(triggers) == {"push", "pull_request"}
    assert WORKFLOW["permissions"] == {"contents": "read"}
    assert "permissions" not in JOB
    assert not re.search(r"secrets\.|github\.token|github-token|GITHUB_TOKEN", WORKFLOW_TEXT)
    assert not [each for each in commands() if "${{" in each]
    (checkout,) = [step for step in JOB["steps"] if step.get("uses", "").startswith("actions/checkout@")]
    assert checkout["with"]["persist-credentials"] is False
    assert JOB["timeout-minutes"] <= 30
