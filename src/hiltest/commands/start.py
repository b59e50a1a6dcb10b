"""``hiltest start``: from an ELF in a repository to a rig, a baseline and a workflow that judges every change."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import webbrowser
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

import click

from hiltest import __version__
from hiltest.commands.options import documented, parsed
from hiltest.errors import ConfigError
from hiltest.session.rig_proposal import ask_for_option, ask_user, is_dialogue, legible_name, propose_rig
from hiltest.session.settings import DEFAULT_OUT, file_name

_EXIT_CODES = """
\b
Exit codes:
  0   the files are written, and the firmware passed
  2   interrupted
  4   usage: an option, the ELF or a file in the way is wrong
  other codes: those of hiltest run, whose verdict is printed
"""
_WORKFLOW = Path(".github", "workflows", "hiltest.yml")
_IGNORED = f"{DEFAULT_OUT}/"
# Build systems by the file that shows them: command, and packages of the runner or of pip.
_APT = "sudo apt-get update && sudo apt-get install --yes gcc-arm-none-eabi libnewlib-arm-none-eabi cmake ninja-build"
_BUILDS = {
    "platformio.ini": ("pio run", "python3 -m pip install platformio"),
    "CMakeLists.txt": ("cmake -B build && cmake --build build", _APT),
    "Makefile": ("make", _APT),
}
_MOST_ELFS = 9
_ACTION = re.compile(r"[\w.-]+/[\w.-]+@[\w./-]+( # .*)?")
_UNKNOWN_ACTION = f"OWNER/hiltest@v{__version__}"
_ACTION_FORM = f"OWNER/NAME@REF, such as {_UNKNOWN_ACTION}"
_ADD_BUILD = "Add a step that builds it, or remove the workflow and repeat with --build COMMAND."
_TEXT = """name: hiltest

on:
  push:
    branches: [{branch}]
  pull_request:

permissions:
  contents: read
  pull-requests: write # for the comment with the verdict

jobs:
  virtual-board:
    runs-on: ubuntu-24.04
    timeout-minutes: 15
    steps:
      - uses: actions/checkout@fbc6f3992d24b796d5a048ff273f7fcc4a7b6c09 # v5.1.0
        with:
          persist-credentials: false
{build}      - uses: {action}
        with:
          firmware: {firmware}
{rig}          baseline: {baseline}
          comment-token: ${{{{ github.token }}}}
"""
_BUILD_TEXT = """      - name: Install the compiler
        run: {install}
      - name: Build the firmware
        run: |
{commands}
"""


@dataclass(frozen=True, slots=True)
class Started:
    """A repository whose firmware is judged."""

    firmware: str
    """ELF that was judged."""
    rig: str | None
    """File of the rig; null for hiltest's own firmware, which needs none."""
    baseline: str | None
    workflow: str | None
    """Files for later runs; null if the firmware cannot run on a virtual board, or its run was not evaluated."""
    exit_code: int | None
    """Exit code of the run; null without one."""


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.start/1")
@click.argument("elf", required=False, callback=parsed(file_name))
@click.option(
    "--build",
    metavar="COMMAND",
    help="Build the ELF in the workflow by this command.  [default: asked, or by the files of this folder]",
)
@click.option(
    "--action",
    metavar="OWNER/NAME@REF",
    help="Use hiltest's action from this repository in the workflow.  [default: the one hiltest was installed from]",
)
def start(elf: str | None, build: str | None, action: str | None) -> tuple[int, Started]:
    """Judge a firmware, and write a workflow for its changes.

    ELF is found below this folder, or asked for. The command writes a rig for firmware that has its own output, runs
    the suites, saves the run as baseline, writes a workflow for GitHub Actions and a line of .gitignore, and opens
    the report. Files that exist are used and not replaced, so that the command can be repeated after a change of
    the rig.
    """
    folder = Path.cwd()
    if action is not None and not _ACTION.fullmatch(action):
        raise ConfigError(f"--action {action} is not {_ACTION_FORM}")
    firmware = _below(folder, Path(elf) if elf else _chosen_elf(folder))
    rig, runs = _write_rig(folder, firmware)
    if not runs:
        click.echo(f"Run it on its own board: hiltest run --rig {rig} --port PORT. No workflow was written.")
        return 0, Started(str(firmware), str(rig), None, None, None)
    baseline = Path("hil", "baselines", f"{legible_name(firmware.stem)}.json")
    command, workflow = None, ""
    if _WORKFLOW.exists():
        click.echo(f"{_WORKFLOW} exists and stays as it is; without it, --build and --action make a new one.")
    else:
        command = _build_command(folder, firmware, build)
        workflow = _workflow_text(folder, firmware, rig, baseline, command, action)
    _ignore_record(folder)
    options = ["--rig", str(rig)] if rig else []
    code = _hiltest("run", "--firmware", str(firmware), *options)
    if code not in (0, 1):
        if rig:
            click.echo(f"Correct {rig} and repeat hiltest start; hiltest listen --rig {rig} shows its values.")
        return code, Started(str(firmware), str(rig) if rig else None, None, None, code)
    if not baseline.exists():
        baseline.parent.mkdir(parents=True, exist_ok=True)
        if saved := _hiltest("baseline", "save", DEFAULT_OUT, str(baseline)):
            raise ConfigError(f"the run cannot be a baseline (exit code {saved}); correct its cause and repeat")
    if workflow:
        _write(_WORKFLOW, workflow)
    committed = [rig, baseline, _WORKFLOW, Path(".gitignore")]
    is_missing = command == "" and _is_ignored(folder, firmware)
    if command == "" and not is_missing:
        committed.insert(0, firmware)
    _show_files(folder, [path for path in committed if path])
    if is_missing:
        click.echo(
            f"The workflow cannot find {firmware}: git ignores it, and {_WORKFLOW} does not build it. {_ADD_BUILD}"
        )
    if f" {_UNKNOWN_ACTION}\n" in workflow:
        click.echo(f"Replace OWNER in {_WORKFLOW} by the owner of hiltest's repository.")
    _open_report(folder / DEFAULT_OUT / "report.html")
    return code, Started(str(firmware), str(rig) if rig else None, str(baseline), str(_WORKFLOW), code)


def _chosen_elf(folder: Path) -> Path:
    """Return the ELF below a folder; if there are several, the one that the user selects."""
    elves = sorted(
        path.relative_to(folder)
        for path in folder.rglob("*.elf")
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )
    if not elves:
        raise ConfigError(f"{folder} has no file *.elf; build your firmware, or name it: hiltest start FILE")
    if len(elves) == 1:
        return elves[0]
    names = [str(path) for path in elves[:_MOST_ELFS]]
    if not is_dialogue():
        raise ConfigError(f"several ELFs: {', '.join(names)}; name one: hiltest start {names[0]}")
    return elves[ask_for_option("Which ELF is your firmware?", names)]


def _below(folder: Path, firmware: Path) -> Path:
    """Return the path of a file below a folder, relative to it."""
    if not firmware.is_file():
        fault = "is no regular file" if firmware.exists() else "does not exist"
        raise ConfigError(f"{firmware} {fault}; build your firmware, or name it: hiltest start FILE")
    if not firmware.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(f"{firmware} is outside of {folder}; run hiltest start in the repository that builds it")
    if "${{" in str(firmware.resolve()):
        raise ConfigError(f"{firmware}: GitHub evaluates ${{{{ in a workflow; rename the file")
    return firmware.resolve().relative_to(folder.resolve())


def _write_rig(folder: Path, firmware: Path) -> tuple[Path | None, bool]:
    """Write the rig of firmware with its own output; return its file, and whether a virtual board runs it."""
    from hiltest.rig.rig_file import load_rig

    rig = Path("hil", "rigs", f"{legible_name(firmware.stem)}.toml")
    if rig.exists():
        click.echo(f"{rig} exists and is used; without it, the command proposes a new one.")
    else:
        if (text := propose_rig(rig.stem, folder, firmware)) is None:
            return None, True
        _write(rig, text)
    return rig, load_rig(rig).board.kind == "virtual"


def _build_command(folder: Path, firmware: Path, build: str | None) -> str:
    """Return the command that builds the firmware in a workflow; empty without one."""
    command = next((_BUILDS[name][0] for name in _BUILDS if (folder / name).exists()), "")
    if build is not None or not is_dialogue():
        return command if build is None else build
    default = command or ("added to the workflow later" if _is_ignored(folder, firmware) else "none, it is committed")
    return ask_user(f"Which command builds {firmware} in a clean checkout? Enter: {default}\n> ") or command


def _workflow_text(
    folder: Path, firmware: Path, rig: Path | None, baseline: Path, command: str, action: str | None
) -> str:
    install = next((_BUILDS[name][1] for name in _BUILDS if (folder / name).exists()), _APT)
    action = action or _own_action()
    if action is None and is_dialogue():
        question = "Which repository has hiltest, as OWNER/NAME@TAG? Enter: fill it in later\n> "
        while (action := ask_user(question)) and not _ACTION.fullmatch(action):
            click.echo(f"{action} is not {_ACTION_FORM}.")
    if not action:
        action = _UNKNOWN_ACTION
    commands = "\n".join(f"          {line}" for line in command.splitlines())
    return _TEXT.format(
        branch=_quoted(_branch(folder)),
        build=_BUILD_TEXT.format(install=install, commands=commands) if command else "",
        action=action,
        firmware=_quoted(firmware.as_posix()),
        rig=f"          rig: {_quoted(rig.as_posix())}\n" if rig else "",
        baseline=_quoted(baseline.as_posix()),
    )


def _own_action() -> str | None:
    """Return the repository on GitHub that hiltest was installed from, with the commit; None for another origin."""
    origin = json.loads(distribution("hiltest").read_text("direct_url.json") or "{}")
    address = re.fullmatch(r"https://github\.com/([\w.-]+/[\w.-]+?)(?:\.git)?/?", origin.get("url", ""))
    commit = origin.get("vcs_info", {}).get("commit_id")
    return f"{address[1]}@{commit} # v{__version__}" if address and commit else None


def _branch(folder: Path) -> str:
    return _git(folder, "symbolic-ref", "--short", "HEAD").stdout.strip() or "main"


def _is_ignored(folder: Path, file: Path) -> bool:
    return _git(folder, "check-ignore", "--quiet", "--", str(file)).returncode == 0


def _git(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Return the answer of git, which fails if it is not installed."""
    command = ["git", *words]
    try:
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=60)
    except OSError:
        return subprocess.CompletedProcess(command, 127, "", "")


def _ignore_record(folder: Path) -> None:
    file = folder / ".gitignore"
    text = file.read_text(encoding="utf-8") if file.exists() else ""
    if _IGNORED not in text.splitlines():
        _write(file, f"{text}{'' if text.endswith(chr(10)) or not text else chr(10)}{_IGNORED}\n")


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from error


def _hiltest(*words: str) -> int:
    """Run a command of hiltest at this terminal, and return its exit code."""
    click.echo(f"hiltest {' '.join(words)}")
    return subprocess.run([sys.executable, "-m", "hiltest", *words], stdout=sys.stdout.fileno(), check=False).returncode


def _show_files(folder: Path, files: list[Path]) -> None:
    has_git = _git(folder, "rev-parse", "--git-dir").returncode == 0
    use = "Commit these files" if has_git else "Put these files into a git repository on GitHub"
    click.echo(f"{use}; the workflow judges every push and pull request:")
    for path in files:
        click.echo(f"  {path}")


def _open_report(report: Path) -> None:
    has_display = sys.platform in ("darwin", "win32") or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()
    if is_dialogue() and has_display:
        webbrowser.open(report.as_uri())


def _quoted(text: str) -> str:
    """Return a string for YAML, in quotes if it needs them."""
    return text if re.fullmatch(r"[A-Za-z][\w./-]*", text) else json.dumps(text)
