"""``--hil-record`` and ``--hil-replay``: the same run from its recording, or where it is another."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.finished_run import run_module, without_volatile

SUITE = """
from hiltest.orientation.angles import Pose
from hiltest.link.messages import Average
from hiltest.link.messages import LinkStatistics


def test_slots(board, measure):
    measure("board.slots", board.identity.slots, "")
    measure("board.frames", board.session.request(LinkStatistics()).frames, "")


def test_turned(board, turntable, measure):
    turntable.turn_to(Pose(30.0, 0.0, 0.0), known_angle=2)
    average = board.session.request(Average(16))
    measure("board.x", float(average.magnetometer.mean[0]), "")
    measure("board.sent", board.now_s(), "s")
    measure("board.true_heading", board.true_attitude(100_000).heading_deg, "deg")
"""
Edit = Callable[[list[str]], list[str]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded run: the suite, ``run.jsonl`` and its record in ``hil-out``."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "test_bench.py").write_text(SUITE, encoding="utf-8")
    done = run_module("pytest", "-p", "hiltest", "-q", "test_bench.py", "--hil-record=run.jsonl", folder=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture
def replay(
    recorded: Path, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[int, dict[str, Any], str]]:
    """Replay the recording, edited, with a suite and options; return exit code, record and output."""
    monkeypatch.delenv("HIL_RIG")

    def run(*options: str, edit: Edit = lambda lines: lines, suite: str = SUITE) -> tuple[int, dict[str, Any], str]:
        (pytester.path / "test_bench.py").write_text(suite, encoding="utf-8")
        lines = (recorded / "run.jsonl").read_text(encoding="utf-8").splitlines()
        (pytester.path / "run.jsonl").write_text("\n".join(edit(lines)) + "\n", encoding="utf-8")
        done = pytester.runpytest_inprocess("test_bench.py", "--hil-replay=run.jsonl", *options)
        file = pytester.path / "hil-out" / "run.json"
        record = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        return int(done.ret), record, " ".join((done.stdout.str() + done.stderr.str()).split())

    return run


def line_of(lines: list[str], text: str) -> int:
    """Return the index of the first line with a text behind the beginning of the second test."""
    begins = next(at for at, line in enumerate(lines) if '"mark"' in line and "test_turned" in line)
    return next(at for at in range(begins, len(lines)) if text in lines[at])


def with_another_byte(lines: list[str], direction: str) -> list[str]:
    at = line_of(lines, f'"dir": "{direction}"')
    while len(json.loads(lines[at])["hex"]) < 20:
        at += 1
    entry = json.loads(lines[at])
    entry["hex"] = f"{entry['hex'][:10]}{int(entry['hex'][10:12], 16) ^ 1:02x}{entry['hex'][12:]}"
    return [*lines[:at], json.dumps(entry), *lines[at + 1 :]]


def test_a_replay_gives_the_same_record_but_for_what_is_volatile(
    recorded: Path, replay: Callable[..., tuple[int, dict[str, Any], str]]
) -> None:
    code, again, output = replay()
    first = json.loads((recorded / "hil-out" / "run.json").read_text(encoding="utf-8"))
    assert code == 0
    assert "replay of virtual FRDM-K64F, seed 1" in output
    assert (first["board"]["kind"], again["board"]["kind"]) == ("virtual", "replay")
    assert again["board"]["recording"]["file"].endswith("run.jsonl")
    for place in (*first["volatile"], *again["volatile"]):
        assert place.rpartition("/")[0] in ("", "/board") or "duration_s" in place or place.startswith("/measurements/")
    volatile = sorted({*first.pop("volatile"), *again.pop("volatile")})
    assert without_volatile({**first, "volatile": volatile}) == without_volatile({**again, "volatile": volatile})


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda lines: with_another_byte(lines, "<"), ["test_turned asks position()", "sent LINK_STATISTICS"]),
        (lambda lines: with_another_byte(lines, ">"), ["test_turned sends AVERAGE", "sent "]),
        (lambda lines: lines[: line_of(lines, '"dir": ">"')], ["test_turned sends AVERAGE", "it was cut short"]),
    ],
    ids=["another byte of an answer", "another byte of a request", "no end"],
)
def test_a_recording_that_was_changed_is_a_divergence_at_its_line(
    replay: Callable[..., tuple[int, dict[str, Any], str]], edit: Edit, message: list[str]
) -> None:
    code, record, output = replay(edit=edit)
    assert code == 20
    test = next(test for test in record["tests"] if test["id"].endswith("test_turned"))
    assert test["outcome"] == "connection lost"
    assert "this run differs from the recorded one" in test["reason"]
    assert "but run.jsonl:" in test["reason"]
    for item in message:
        assert item in test["reason"], output


def test_another_question_says_what_was_asked_and_what_had_been(
    replay: Callable[..., tuple[int, dict[str, Any], str]],
) -> None:
    code, record, _ = replay(suite=SUITE.replace("Pose(30.0", "Pose(31.0"))
    reason = record["tests"][-1]["reason"]
    assert code == 20
    assert 'asks stage-1.turn_to(pose={"heading_deg": 31.0' in reason
    assert 'asked stage-1.turn_to(pose={"heading_deg": 30.0' in reason
    assert "s in test_bench.py::test_turned" in reason


def test_fewer_tests_than_were_recorded_are_a_divergence(
    replay: Callable[..., tuple[int, dict[str, Any], str]],
) -> None:
    code, record, output = replay("-k", "slots")
    assert code == 20
    assert record["tests"][-1]["id"] == "replay"
    assert "the end of the run asks board.memory_use(), but run.jsonl:" in output
    code, record, _ = replay("-k", "turned")
    assert code == 20
    assert "test_turned" in record["tests"][0]["reason"]
    assert "in test_bench.py::test_slots" in record["tests"][0]["reason"]


def test_a_rig_of_other_conditions_is_refused_and_one_of_other_limits_is_not(
    replay: Callable[..., tuple[int, dict[str, Any], str]], default_rig: str, tmp_path: Path
) -> None:
    rig = tmp_path / "other.toml"
    limits = '[limits]\n"board.slots" = { max = 2, unit = "" }\n'
    rig.write_text(default_rig.partition("[limits]")[0] + limits, encoding="utf-8")
    code, record, output = replay(f"--hil-rig={rig}")
    assert code == 1, output
    assert "board.slots" in record["verdict"]["sentence"]
    rig.write_text(default_rig.replace("dip_deg = 62.0", "dip_deg = 61.0"), encoding="utf-8")
    code, _, output = replay(f"--hil-rig={rig}")
    assert code == pytest.ExitCode.USAGE_ERROR
    assert "field.dip_deg is 61.0, and was 62.0" in output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--hil-firmware=app.elf"], "--hil-firmware does not go with --hil-replay"),
        (["--hil-seed=2"], "--hil-seed does not go with --hil-replay"),
        (["--hil-record=new.jsonl"], "--hil-record does not go with --hil-replay"),
        (["-n1"], "a single process"),
    ],
)
def test_what_a_replay_cannot_have_is_refused(
    replay: Callable[..., tuple[int, dict[str, Any], str]], options: list[str], message: str
) -> None:
    if "-n1" in options:
        pytest.importorskip("xdist")
    code, _, output = replay(*options)
    assert code == pytest.ExitCode.USAGE_ERROR
    assert message in output


def test_a_wire_trace_is_no_recording(replay: Callable[..., tuple[int, dict[str, Any], str]]) -> None:
    header = '{"schema": "hiltest.transcript/1", "clock": "virtual"}'
    code, _, output = replay(edit=lambda lines: [header, *lines[1:]])
    assert code == pytest.ExitCode.USAGE_ERROR
    assert "a wire trace, not a recording of a run" in output


def test_a_recording_that_cannot_be_written_is_refused_before_a_test_runs(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(SUITE)
    result = pytester.runpytest_inprocess("--hil-record=no/run.jsonl")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*cannot write *run.jsonl: No such file or directory; name another file*"])


def test_a_replay_is_no_base_for_a_board_and_none_is_for_it(
    recorded: Path, replay: Callable[..., tuple[int, dict[str, Any], str]], pytester: pytest.Pytester
) -> None:
    code, _, output = replay(f"--hil-baseline={recorded / 'hil-out' / 'run.json'}")
    assert code == 22
    assert "another kind of board: virtual before, replay of " in output
    code, _, output = replay("--hil-out=again", f"--hil-baseline={pytester.path / 'hil-out' / 'run.json'}")
    assert code == 0, output
    assert "run.json): PASS: " in " ".join(output.split())
