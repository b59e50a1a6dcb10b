"""``hiltest bisect`` over repositories that are made for it: small programs, built and run on the virtual board."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.command_files import checked

from ..virtual.conftest import FLAGS, PROGRAMS

pytestmark = pytest.mark.slow

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
COMMITS = 40
PROGRAM = """\
#define CPACR (*(volatile unsigned *)0xE000ED88)
volatile float heading_deg;
volatile unsigned version = {version};

int main(void)
{{
    CPACR |= 0xFu << 20;
    __asm volatile("dsb\\n isb");
    for (;;)
        heading_deg = {heading}f;
}}
"""
SUITE = """
import pytest
from hiltest.interfaces.quantities import Quantity

pytestmark = pytest.mark.hil


def test_heading(board, measure):
    board.output.observe(0.2)
    measure("heading.firmware.rms", abs(float(board.output.latest[Quantity.HEADING][0]) - 90.0), "deg")


def test_lamp(measure):
    measure("lamp.current", 2.0, "mA")
"""
DEVICE = """
[device]
kind = "memory"

[device.memory.values]
heading = { path = "heading_deg", unit = "deg" }
"""
WALL_LIMIT_S = 600.0  # for what takes half a minute on a machine of its own
MEASURE = ("--measure", "heading.firmware.rms")


@dataclass(frozen=True)
class Done:
    """A command that has ended."""

    code: int
    out: str
    errors: str


@dataclass(frozen=True)
class Repository:
    """A repository of a program, one commit after the other, and its build command."""

    folder: Path
    build: str

    def git(self, *words: str) -> str:
        command = ["git", "-C", str(self.folder), "-c", "user.name=A. Tester", "-c", "user.email=a@example.org", *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def commit(self, subject: str, program: str) -> str:
        (self.folder / "program.c").write_text(program, encoding="utf-8")
        (self.folder / "NEWS").write_text(subject, encoding="utf-8")
        self.git("add", ".")
        self.git("commit", "--quiet", "-m", subject)
        return self.git("rev-parse", "HEAD")

    def begin(self, good: str, bad: str, *options: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "hiltest", "bisect", good, bad, "--firmware", "build/app.elf", *options]
        given = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
        return subprocess.Popen(
            [*command, "--", self.build],
            cwd=self.folder,
            env=given,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def bisect(self, good: str, bad: str, *options: str) -> Done:
        with self.begin(good, bad, *options) as running:
            out, errors = running.communicate(timeout=WALL_LIMIT_S)
        return Done(running.returncode, out, errors)


@pytest.fixture(scope="module")
def make_repository(
    tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]
) -> Callable[..., Repository]:
    """Return a function that makes a repository with a bench."""
    compiler = require_tool("arm-none-eabi-gcc")
    start = tmp_path_factory.mktemp("start") / "start.o"  # not each time, from a temporary file: an ELF has its name
    subprocess.run([compiler, *FLAGS, "-c", str(PROGRAMS / "start.S"), "-o", str(start)], check=True, timeout=60.0)

    def make() -> Repository:
        folder = tmp_path_factory.mktemp("repository")
        command = [compiler, *FLAGS, str(start), "program.c", "-o", "build/app.elf"]
        repository = Repository(folder, f"mkdir -p build && {shlex.join(command)}")
        repository.git("init", "--quiet", "--initial-branch=main")
        for name in ("suites", "rigs"):
            (folder / "hil" / name).mkdir(parents=True)
        (folder / "hil" / "suites" / "test_heading.py").write_text(SUITE, encoding="utf-8")
        rig = RIG.read_text(encoding="utf-8")
        (folder / "hil" / "rigs" / RIG.name).write_text(rig[: rig.index("[limits]")] + DEVICE, encoding="utf-8")
        (folder / ".gitignore").write_text("build/\nhil-out/\n", encoding="utf-8")
        return repository

    return make


BROKEN = range(17, 23)
FIRST_WORSE = 29


@pytest.fixture(scope="module")
def forty(make_repository: Callable[[], Repository]) -> tuple[Repository, Sequence[str]]:
    """40 commits: those in the middle do not build, and half of all change nothing that is compiled."""
    repository = make_repository()
    commits = []
    for number in range(COMMITS):
        program = PROGRAM.format(version=number // 2, heading=90.4 if number < FIRST_WORSE else 90.9)
        commits.append(repository.commit(f"change {number}", program + "int main(void\n" * (number in BROKEN)))
    return repository, commits


@pytest.fixture(scope="module")
def done(forty: tuple[Repository, Sequence[str]]) -> Done:
    """A bisection that was interrupted, and then went on; the checkout that it is typed in has an edit."""
    repository, commits = forty
    (repository.folder / "program.c").write_text("not committed", encoding="utf-8")
    with repository.begin(commits[0], "main") as running:
        assert running.stderr is not None
        judged = [running.stderr.readline() for _ in range(2)]  # the good one and the bad one
        assert all(line.endswith(" s]\n") for line in judged), judged
        os.killpg(running.pid, signal.SIGINT)
        _, errors = running.communicate(timeout=WALL_LIMIT_S)
    assert running.returncode == 2, errors
    assert "hil-out/bisect keeps the finished builds and runs: repeat the command to continue" in errors
    assert "Traceback" not in errors
    return repository.bisect(commits[0], "main", "--json")


def test_the_first_of_forty_commits_that_is_worse_is_found_past_a_broken_build(
    forty: tuple[Repository, Sequence[str]], done: Done
) -> None:
    repository, commits = forty
    assert done.code == 0, done.errors
    content = checked(done.out, "hiltest.bisection/1")
    (first,) = content["candidates"]
    assert first["commit"] == commits[FIRST_WORSE]
    assert (first["subject"], first["author"]) == (f"change {FIRST_WORSE}", "A. Tester")
    assert first["author_date"] == repository.git("show", "-s", "--format=%aI", commits[FIRST_WORSE])
    assert content["before"]["commit"] == commits[FIRST_WORSE - 1]
    (worse,) = [
        difference for difference in content["against_before"]["differences"] if difference["change"] == "worse"
    ]
    assert worse["name"] == "heading.firmware.rms"
    assert worse["base"] == pytest.approx(0.4, abs=1e-5)  # a float32 near 90 has steps of 8e-6
    assert worse["new"] == pytest.approx(0.9, abs=1e-5)
    judged = {step["commit"]: step for step in content["steps"]}
    broken = [item for item in judged.values() if item["found"] == "skipped"]
    assert broken
    assert {item["commit"] for item in broken} <= {commits[number] for number in BROKEN}
    assert all(item["because"].startswith("it does not build: program.c:") for item in broken)
    # Halving 39 takes six at most, and each skipped one costs one more.
    assert len(judged) - len(broken) <= 6
    assert [line.endswith(" [remembered]") for line in done.errors.splitlines()[:2]] == [True, True]
    assert "step 1 of about 5" in done.errors
    assert " left: " in done.errors


def test_the_checkout_and_its_edits_stay_and_no_working_tree_is_left(
    forty: tuple[Repository, Sequence[str]], done: Done
) -> None:
    repository, _ = forty
    assert done.code == 0
    assert (repository.folder / "program.c").read_text(encoding="utf-8") == "not committed"
    assert repository.git("branch", "--show-current") == "main"
    assert len(repository.git("worktree", "list").splitlines()) == 1
    assert not (repository.folder / ".git" / "BISECT_LOG").exists()


def test_two_commits_that_build_the_same_elf_are_run_once(done: Done) -> None:
    content = checked(done.out, "hiltest.bisection/1")
    records: dict[tuple[int, str], set[str]] = {}
    for item in (content["good"], content["bad"], *content["steps"]):
        if item["record"]:
            records.setdefault((int(item["subject"].split()[1]) // 2, item["found"]), set()).add(item["record"])
    assert all(len(record) == 1 for record in records.values())
    assert len({record for item in records.values() for record in item}) == len(records)


def test_the_same_command_again_builds_and_runs_nothing_that_was_built(
    forty: tuple[Repository, Sequence[str]], done: Done
) -> None:
    repository, commits = forty
    assert done.code == 0
    records = sorted((repository.folder / "hil-out" / "bisect" / "runs").rglob("run.json"))
    written = [path.stat().st_mtime_ns for path in records]
    again = repository.bisect(commits[0], "main")
    assert again.code == 0, again.errors
    assert [path.stat().st_mtime_ns for path in records] == written
    assert all(line.endswith("[remembered]") or ": skipped, " in line for line in again.errors.splitlines())
    answer = " ".join(again.out.split())
    assert f"{commits[FIRST_WORSE][:12]} change {FIRST_WORSE} is the first worse commit" in answer
    assert "heading.firmware.rms 0.4 -> 0.9 deg (+0.5, " in answer
    assert "skipped: " in answer


@pytest.mark.parametrize(
    ("good", "bad", "options", "complaint"),
    [
        (0, 16, (), "is not worse than"),
        (39, 0, (), "exchange them"),
        (0, 0, (), "are the same commit"),
        (17, 39, (), "is not a good commit: it does not build: program.c:"),
        (0, 39, ("--measure", "heading.firmware.rsm"), "did you mean 'heading.firmware.rms'?"),
        (0, 39, ("--measure", "lamp.*"), "is not worse than"),
    ],
    ids=["not worse", "exchanged", "the same", "broken", "no such measurement", "another measurement"],
)
def test_what_cannot_be_bisected_is_said_at_once(
    forty: tuple[Repository, Sequence[str]],
    done: Done,
    good: int,
    bad: int,
    options: tuple[str, ...],
    complaint: str,
) -> None:
    repository, commits = forty
    assert done.code == 0
    refusal = repository.bisect(commits[good], commits[bad], *options)
    assert refusal.code == 4, refusal.out + refusal.errors
    assert complaint in refusal.errors.splitlines()[-1]
    assert "step 1" not in refusal.errors


def test_where_the_commits_before_a_worse_one_cannot_be_judged_it_says_one_of_these(
    make_repository: Callable[[], Repository],
) -> None:
    repository = make_repository()
    good = repository.commit("good", PROGRAM.format(version=1, heading=90.4))
    between = [
        repository.commit("does not build", "int main(void"),
        repository.commit("does not point", PROGRAM.format(version=1, heading=90.4).replace("heading_deg", "h")),
    ]
    worse = repository.commit("worse", PROGRAM.format(version=1, heading=90.9))
    repository.commit("later", PROGRAM.format(version=2, heading=90.9))
    done = repository.bisect(good, "main", *MEASURE, "--json")
    assert done.code == 22, done.errors
    content = checked(done.out, "hiltest.bisection/1")
    assert [candidate["commit"] for candidate in content["candidates"]] == [worse, *reversed(between)]
    assert content["before"]["commit"] == good
    reasons = [candidate["because"] for candidate in content["candidates"][1:]]
    assert "heading_deg" in reasons[0]
    assert reasons[1].startswith("it does not build: program.c:")


FAULTS = "volatile float heading_deg;\nint main(void)\n{\n    return *(volatile int *)0xF0000000;\n}\n"


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [((), 0, "unmapped address 0xf0000000"), (MEASURE, 4, "it has no value of heading.firmware.rms")],
    ids=["all", "one"],
)
def test_firmware_that_faults_is_worse_unless_one_measurement_decides(
    make_repository: Callable[[], Repository], options: tuple[str, ...], code: int, message: str
) -> None:
    repository = make_repository()
    good = repository.commit("good", PROGRAM.format(version=1, heading=90.4))
    faults = repository.commit("faults", FAULTS)
    done = repository.bisect(good, "main", *options)
    assert done.code == code, done.errors
    assert message in done.out + done.errors
    assert (f"{faults[:12]} faults is the first worse commit" in done.out) == (code == 0)
