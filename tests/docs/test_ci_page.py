"""The workflow of the page about CI: its steps run as they stand, red where something got worse, and need no token."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import yaml

from hiltest import __version__
from hiltest.verdict.baseline_file import read_baseline, to_json
from hiltest.verdict.evidence import Accepted

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
(WORKFLOW_TEXT,) = re.findall(r"^```yaml\n(.*?)^```", PAGE, re.M | re.S)
WORKFLOW = yaml.safe_load(WORKFLOW_TEXT)
SET_UP, WHEN_WORSE, OVER_TIME = (block.splitlines() for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S))
(JOB,) = WORKFLOW["jobs"].values()
ACTION = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
USES = f"OWNER/hiltest@v{__version__}"
(WITH,) = [step["with"] for step in JOB["steps"] if step.get("uses") == USES]
INPUTS = {name: item["default"] for name, item in ACTION["inputs"].items()} | WITH
BASELINE = Path("hil") / "baselines" / "mine.json"
COMMITTED = ROOT / "hil" / "baselines" / "virtual-k64f.json"

# The two lines of the job that are not run as they stand: hiltest is the one under test, and both are installed.
INSTALL = 'python -m pip install "$GITHUB_ACTION_PATH"'
INSTALL_COMPILER = (
    "sudo apt-get update && sudo apt-get install --yes gcc-arm-none-eabi libnewlib-arm-none-eabi cmake ninja-build"
)
FIRMWARE = ROOT / "firmware_stub"
ELF = Path("build") / "mine.elf"
RUN = "Run on the virtual board"
REVIEW = "Review the changes to the baseline"
COMMENT = "Comment on the pull request"
SHAS = {"green": "a" * 40, "red": "b" * 40}

# Of three runs on the main branch; the record of one is gone.
GH = """#!/bin/sh
case "$*" in
"run list --workflow hiltest.yml --branch main --event push --limit 50 "*) echo 12 11 10 ;;
"run download $3 --name hiltest --dir history/$3") mkdir -p history && cp -r "{kept}/$3/hiltest" "$7" ;;
*) echo "gh: $*" >&2; exit 1 ;;
esac
"""

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


def checkout_of(sha: str) -> dict[str, str]:
    """Return what a job has of the commit that it has checked out."""
    return {"GITHUB_SHA": sha, "GITHUB_REF_NAME": "main"}


def sh(command: str, folder: Path, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run a line as GitHub's shell does."""
    return subprocess.run(
        ["bash", "-e", "-c", command],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=WALL_LIMIT_S,
        stdin=subprocess.DEVNULL,
        **{"env": environment(folder)} | more,
    )


def filled(value: Any, inputs: dict[str, str]) -> Any:
    """Return what a step of the action is given, with the action's inputs filled in as GitHub does it."""
    if isinstance(value, dict):
        return {name: filled(item, inputs) for name, item in value.items()}
    return re.sub(r"\$\{\{ inputs\.([\w-]+) }}", lambda result: inputs[result[1]], value)


def steps_of(inputs: dict[str, str]) -> Iterator[dict[str, Any]]:
    """Return the steps of the job, those of the action in the place where the job uses it."""
    for step in JOB["steps"]:
        if step.get("uses") != USES:
            yield step
            continue
        for inner in ACTION["runs"]["steps"]:
            yield inner | {name: filled(inner[name], inputs) for name in ("env", "with") if name in inner}


STEPS = list(steps_of(INPUTS))


def run_job(folder: Path, sha: str) -> dict[str, Ran]:
    """Run the steps of the job that are commands in a checked-out folder; those behind a red one as `if` says."""
    ran: dict[str, Ran] = {}
    for number, step in enumerate(STEPS):
        red = any(item.code for item in ran.values())
        if "run" not in step or (red and "!cancelled()" not in step.get("if", "")):
            continue
        if "github.base_ref" in step.get("if", "") or step["name"] == COMMENT:
            continue  # of a pull request
        summary = folder.parent / f"summary-{number}.md"  # one of its own a step, as GitHub has it
        command = "true" if step["run"] in (INSTALL, INSTALL_COMPILER) else step["run"]
        done = sh(command, folder, env=environment(folder, summary) | checkout_of(sha) | step.get("env", {}))
        text = summary.read_text(encoding="utf-8") if summary.exists() else ""
        ran[step["name"]] = Ran(done.returncode, done.stdout + done.stderr, text)
    return ran


def the_run(ran: dict[str, Ran]) -> Ran:
    return ran[RUN]


@pytest.fixture(scope="module")
def set_up(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    """A repository with the firmware in it, after the page's commands to set it up."""
    for tool in ("arm-none-eabi-gcc", "cmake"):
        require_tool(tool)
    folder = tmp_path_factory.mktemp("set-up") / "repository"
    shutil.copytree(FIRMWARE, folder / "firmware_stub", ignore=shutil.ignore_patterns("__pycache__"))
    for command in SET_UP:
        done = sh(command, folder)
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
    return folder


def checked_out(repository: Path, folder: Path) -> Path:
    """Return what a runner has checked out: what the page says to ignore is not there."""
    for name in ("firmware_stub", "hil"):
        shutil.copytree(repository / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def green(set_up: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Ran]]:
    """What the job does for the firmware that the baseline was saved of."""
    folder = checked_out(set_up, tmp_path_factory.mktemp("green") / "repository")
    return folder, run_job(folder, SHAS["green"])


@pytest.fixture(scope="module")
def red(
    set_up: Path, green: tuple[Path, dict[str, Ran]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Ran]]:
    """What the job does, after the green one, for firmware that has become a cycle dearer."""
    folder = checked_out(set_up, tmp_path_factory.mktemp("red") / "repository")
    source = folder / "firmware_stub" / "calibration" / "direct.c"
    before = "    moments_anchor(points, anchor);\n"
    text = source.read_text(encoding="utf-8")
    assert text.count(before) == 1
    source.write_text(text.replace(before, f'    __asm__ volatile("nop");\n{before}'), encoding="utf-8")
    return folder, run_job(folder, SHAS["red"])


def commands() -> Iterator[str]:
    yield from (step["run"] for step in STEPS if "run" in step)


@pytest.mark.parametrize("file", ["action.yml", "docs/ci.md", "docs/kernels.md"])
def test_actions_of_others_are_pinned_by_commit_with_the_version_beside_it(file: str) -> None:
    used = re.findall(r"uses: (?!OWNER/)(.*)", (ROOT / file).read_text(encoding="utf-8"))
    assert used
    for action in used:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", action), action


def test_only_installations_are_replaced() -> None:
    assert [command for command in commands() if "install" in command] == [INSTALL_COMPILER, INSTALL]
    build = [sys.executable, "-B", str(FIRMWARE / "build.py")]
    refused = subprocess.run(build, env={"PATH": ""}, capture_output=True, text=True, check=False, timeout=60)
    packages = refused.stderr.strip().partition("apt install ")[2]
    assert packages, "it says what to install where there is no compiler"
    assert INSTALL_COMPILER.endswith(f" {packages}")


def test_the_job_builds_what_the_set_up_builds_and_tests_that() -> None:
    (build,) = [step["run"] for step in JOB["steps"] if step.get("name") == "Build the firmware"]
    start = shlex.split(SET_UP[2])
    assert start[:3] == ["hiltest", "start", WITH["firmware"]]
    assert build.strip() == start[start.index("--build") + 1] == " && ".join(SET_UP[:2])
    assert (WITH["firmware"], WITH["baseline"]) == (str(ELF), str(BASELINE))
    assert WHEN_WORSE[0] == f"hiltest run --firmware {ELF} --baseline {BASELINE}", "as the action does it"


def test_start_writes_the_workflow_of_the_page_and_replaces_no_file(set_up: Path) -> None:
    written = set_up / ".github" / "workflows" / "hiltest.yml"
    assert written.read_text(encoding="utf-8") == WORKFLOW_TEXT
    assert (set_up / ".gitignore").read_text(encoding="utf-8") == "hil-out/\n"
    before = {path: path.stat().st_mtime_ns for path in (written, set_up / BASELINE, set_up / ".gitignore")}
    assert sh(SET_UP[2], set_up).returncode == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_the_job_is_green_for_the_firmware_as_it_was_and_shows_its_report(green: tuple[Path, dict[str, Ran]]) -> None:
    folder, ran = green
    assert {name: item.code for name, item in ran.items()} == dict.fromkeys(ran, 0), the_run(ran).said
    run = the_run(ran)
    answer = "May be merged as far as the gate set shows, without [0-9]+ tests of the full set"
    assert re.match(rf"# {answer} \(against hil/baselines/mine.json\): PASS\n", run.summary)
    assert "## Against the baseline" in run.summary
    assert "::error" not in run.said
    record = json.loads((folder / "hil-out" / "run.json").read_text(encoding="utf-8"))
    assert record["comparison"]["obstacles"] == []
    assert record["board"]["firmware_sha256"] == sha256((folder / ELF).read_bytes()).hexdigest(), "the user's own"
    assert record["revision"] == {"commit": SHAS["green"], "branch": "main", "label": ""}
    assert json.loads((folder / "hil-out" / "numbers.bmf").read_text(encoding="utf-8"))


def test_one_cycle_more_is_red_with_the_reason_in_summary_and_annotation(red: tuple[Path, dict[str, Ran]]) -> None:
    _, ran = red
    run = the_run(ran)
    assert run.code == 21, run.said
    assert "| worse | cycles.direct.total |" in run.summary
    assert f"commit {SHAS['red'][:12]}, branch main" in run.summary
    (annotation,) = [line for line in run.said.splitlines() if line.startswith("::")]
    assert annotation.startswith("::error title=hiltest%3A regression::")
    assert "cycles.direct.total" in annotation


def test_a_red_job_still_keeps_its_record(red: tuple[Path, dict[str, Ran]]) -> None:
    folder, ran = red
    (upload,) = [step for step in STEPS if step.get("uses", "").startswith("actions/upload-artifact@")]
    assert "!cancelled()" in upload["if"]
    names = {path.name for path in (folder / upload["with"]["path"]).iterdir()}
    assert {"run.json", "report.html", "report.md", "junit.xml", "numbers.bmf"} <= names
    assert len(list(commands())) - 2 == len(ran), "the baseline is reviewed, and the comment written, in a pull request"


def test_the_baseline_that_the_page_saves_is_the_committed_one_of_the_same_seed(set_up: Path) -> None:
    ours, committed = (json.loads(path.read_text(encoding="utf-8")) for path in (set_up / BASELINE, COMMITTED))
    assert ours["seeds"] == [1]
    if ours["side"]["compiler"] != committed["side"]["compiler"]:
        pytest.skip(f"it is of {committed['side']['compiler']}, and here is {ours['side']['compiler']}")
    saved = {measurement["name"]: measurement["values"][0] for measurement in ours["measurements"]}
    of_seed_1 = {measurement["name"]: measurement["values"][0] for measurement in committed["measurements"]}
    # Processors round a sum in float64 otherwise, which the ninth and last digit that is written shows in a difference
    # of two headings. A count of cycles is exact: one of 100 million would be needed to hide a cycle.
    assert {name: saved[name] for name in of_seed_1} == pytest.approx(of_seed_1, rel=1e-8)


def test_a_change_is_accepted_by_name_and_the_job_is_green_again(red: tuple[Path, dict[str, Ran]]) -> None:
    folder, _ = red
    _, update, diff = WHEN_WORSE
    assert diff.startswith("git diff hil/")
    done = sh(update, folder)
    assert done.returncode == 0, done.stderr
    assert "for 0.2 deg less at the poles" in (folder / BASELINE).read_text(encoding="utf-8")
    compared = sh(f"hiltest compare {BASELINE} hil-out", folder)
    assert compared.returncode == 0, compared.stdout


def test_the_records_of_many_jobs_are_fetched_and_shown_together(
    green: tuple[Path, dict[str, Ran]], red: tuple[Path, dict[str, Ran]], tmp_path: Path
) -> None:
    """GitHub's command line is not here: one that answers these two lines stands in, with the records of the jobs."""
    (upload,) = [step for step in STEPS if step.get("uses", "").startswith("actions/upload-artifact@")]
    assert int(upload["with"]["retention-days"]) <= 90
    for number, (folder, _) in ((11, green), (12, red)):
        shutil.copytree(folder / upload["with"]["path"], tmp_path / "kept" / str(number) / upload["with"]["name"])
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "gh").write_text(GH.format(kept=tmp_path / "kept"), encoding="utf-8")
    (tmp_path / "bin" / "gh").chmod(0o755)
    target = environment(tmp_path)
    target["PATH"] = f"{tmp_path / 'bin'}{os.pathsep}{target['PATH']}"
    fetch, show = OVER_TIME
    assert sh(fetch, tmp_path, env=target).returncode == 0
    assert sorted(path.name for path in (tmp_path / "history").iterdir()) == ["11", "12"]
    shown = sh(show, tmp_path, env=target)
    assert (shown.returncode, shown.stderr) == (0, ""), "nothing that the job keeps is a stranger"
    assert f"run 2 (commit {SHAS['red'][:12]}, branch main)" in shown.stdout
    assert "worse: cycles.direct.total" in shown.stdout


def test_every_input_of_the_action_reaches_the_run(tmp_path: Path) -> None:
    """A program that prints its arguments stands in for hiltest: what they do is shown by the run's own tests."""
    (tmp_path / "hiltest").write_text("#!/bin/sh\nprintf '%s\\n' \"$@\"\n", encoding="utf-8")
    (tmp_path / "hiltest").chmod(0o755)
    inputs = INPUTS | {
        "firmware": "my $(id).elf",
        "rig": "mine",
        "seeds": "1..8",
        "out": "out; id",
        "options": "--suite full -- -k 'heading or cycles'",
    }
    (step,) = [step for step in steps_of(inputs) if step.get("name") == RUN]
    target = environment(tmp_path)
    target["PATH"] = f"{tmp_path}{os.pathsep}{target['PATH']}"
    done = sh(step["run"], tmp_path, env=target | step["env"])
    assert done.stdout.splitlines() == [
        "run",
        "--out",
        "out; id",
        "--firmware",
        "my $(id).elf",
        "--baseline",
        str(BASELINE),
        "--rig",
        "mine",
        "--seeds",
        "1..8",
        "--suite",
        "full",
        "--",
        "-k",
        "heading or cycles",
    ]
    unclosed = sh(step["run"], tmp_path, env=target | step["env"] | {"OPTIONS": "-k 'heading"})
    assert (unclosed.returncode != 0, unclosed.stdout) == (True, ""), "it does not run without what was asked for"


@pytest.fixture
def pull_request(tmp_path: Path) -> Path:
    """A checked-out pull request, in which the branch that it is merged into is not yet fetched."""
    origin, clone = tmp_path / "origin", tmp_path / "clone"
    (origin / BASELINE).parent.mkdir(parents=True)
    shutil.copy(COMMITTED, origin / BASELINE)
    git = "git -c user.name=a -c user.email=a@example.com"
    commands = (
        f"git init -q -b main && git add . && {git} commit -qm base && git clone -q --depth=1 file://{origin} {clone}"
    )
    done = sh(f"{commands} && git -C {clone} update-ref -d refs/remotes/origin/main", origin)
    assert done.returncode == 0, done.stderr
    return clone


def reviewed(clone: Path) -> Ran:
    """Run the step of the action that reviews the baseline."""
    (step,) = [step for step in STEPS if step.get("name") == REVIEW]
    summary = clone.parent / "summary.md"
    job = {"GITHUB_BASE_REF": "main", "RUNNER_TEMP": str(clone.parent)}
    done = sh(step["run"], clone, env=environment(clone, summary) | job | step["env"])
    return Ran(done.returncode, done.stdout + done.stderr, summary.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("because", "code", "row"),
    [
        (None, 21, "| worse | cycles.direct.total |"),
        ("a division a fit", 0, "accepted: a division a fit |"),
    ],
    ids=["sealed again", "accepted"],
)
def test_a_pull_request_that_makes_the_baseline_laxer_is_red_unless_it_gives_a_reason(
    pull_request: Path, because: str | None, code: int, row: str
) -> None:
    before = read_baseline(pull_request / BASELINE)
    rows = [
        replace(item, values=tuple(value and 2 * value for value in item.values))
        if item.name == "cycles.direct.total"
        else item
        for item in before.measurements
    ]
    reasons = () if because is None else (Accepted("cycles.direct.total", because, "", "", None, None),)
    after = replace(before, measurements=tuple(rows), history=(*before.history, *reasons))
    (pull_request / BASELINE).write_text(to_json(after), encoding="utf-8")
    ran = reviewed(pull_request)
    assert ran.code == code, ran.said
    assert row in ran.summary


def test_a_pull_request_without_a_change_to_the_baseline_passes_and_a_new_baseline_is_named(pull_request: Path) -> None:
    assert reviewed(pull_request).code == 0
    sh("git checkout -q --orphan other && git rm -rfq . && touch none && git add none", pull_request.parent / "origin")
    commit = "git -c user.name=a -c user.email=a@example.com commit -qm other && git branch -f main other"
    assert sh(commit, pull_request.parent / "origin").returncode == 0
    sh("git update-ref -d refs/remotes/origin/main", pull_request)
    ran = reviewed(pull_request)
    assert (ran.code, "The baseline is new: main has none of this name." in ran.summary) == (0, True), ran.said


def test_the_page_names_the_inputs_of_the_action() -> None:
    assert re.findall(r"^\| `([\w-]+)` \|", PAGE, re.M) == list(ACTION["inputs"])


# Stands in for GitHub: it keeps one comment in a file, and its reader applies no filter but that of the author.
GH_COMMENTS = """#!/bin/sh
printf '%s\\n' "$*" >>calls
case "$*" in
*--jq*) if [ -f denied ]; then exit 1; elif [ -f comment ]; then echo 7; fi ;;
*) for word; do case "$word" in body=@*) cp "${word#body=@}" comment ;; esac; done ;;
esac
"""


def commented(folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the step of the action that comments."""
    (folder / "gh").write_text(GH_COMMENTS, encoding="utf-8")
    (folder / "gh").chmod(0o755)
    target = environment(folder)
    target["PATH"] = f"{folder}{os.pathsep}{target['PATH']}"
    (step,) = [step for step in STEPS if step.get("name") == COMMENT]
    values = {"github.repository": "me/compass", "github.event.pull_request.number": "12"} | variables
    env = {
        name: re.sub(r"\$\{\{ ([\w.-]+) }}", lambda match: values.get(match[1], ""), value)
        for name, value in step["env"].items()
    }
    return sh(step["run"], folder, env=target | env | {"RUNNER_TEMP": str(folder)})


def test_one_comment_has_the_verdict_and_is_replaced_by_the_next_push(tmp_path: Path) -> None:
    (tmp_path / "hil-out").mkdir()
    report = tmp_path / "hil-out" / "report.md"
    report.write_text("# PASS\n\n$(touch broken)\n<details><summary>Every measurement</summary>\nall\n</details>\n")
    url = "https://github.com/me/compass/actions/runs/1/artifacts/2"
    assert commented(tmp_path, **{"steps.record.outputs.artifact-url": url}).returncode == 0
    first = (tmp_path / "comment").read_text(encoding="utf-8")
    assert first == f"<!-- hiltest hiltest -->\n# PASS\n\n$(touch broken)\n\n\n[Record and reports]({url})\n"
    report.write_text("# FAIL\n")
    assert commented(tmp_path).returncode == 0
    assert "# FAIL" in (tmp_path / "comment").read_text(encoding="utf-8")
    posted, patched = [call for call in (tmp_path / "calls").read_text().splitlines() if "--jq" not in call]
    assert posted.startswith("api --silent repos/me/compass/issues/12/comments -F ")
    assert patched.startswith("api --silent --method PATCH repos/me/compass/issues/comments/7 -F ")
    assert not (tmp_path / "broken").exists()


def test_a_token_that_may_not_comment_changes_no_result(tmp_path: Path) -> None:
    (tmp_path / "denied").touch()
    done = commented(tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith("::notice title=hiltest::")
    assert not (tmp_path / "comment").exists()


def test_the_token_reaches_the_comment_alone_and_nothing_runs_that_a_stranger_names() -> None:
    triggers = WORKFLOW[True]  # YAML 1.1 reads the key "on" as a truth
    assert set(triggers) == {"push", "pull_request"}
    assert WORKFLOW["permissions"] == {"contents": "read", "pull-requests": "write"}
    assert "permissions" not in JOB
    assert not re.search(r"secrets\.|github-token|GITHUB_TOKEN", WORKFLOW_TEXT + json.dumps(ACTION))
    steps = [*JOB["steps"], *ACTION["runs"]["steps"]]
    with_token = [step for step in steps if re.search(r"github\.token|comment-token }}", json.dumps(step))]
    assert [step.get("name", step.get("uses")) for step in with_token] == [USES, COMMENT]
    assert not [command for command in commands() if "${{" in command], "an input is no part of a script"
    (checkout,) = [step for step in JOB["steps"] if step.get("uses", "").startswith("actions/checkout@")]
    assert checkout["with"]["persist-credentials"] is False
    assert JOB["timeout-minutes"] <= 30
