"""``--hil-record`` and ``--hil-replay`` of firmware that reports by itself: lines, packets, and its variables."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.finished_run import without_volatile

from hiltest.campaigns.one_run import RunCommand
from hiltest.rig.bench_files import shipped

SUITE = """
from hiltest.orientation.angles import Pose
from hiltest.interfaces.quantities import Moment, Quantity


def test_heard(board, turntable, measure):
    turntable.turn_to(Pose(30.0), known_angle=2)
    board.output.send(Moment.POSE)
    said = board.output.observe(1.0)
    measure("compass.said", len(said), "")
    measure("compass.heading", float(board.output.latest[Quantity.HEADING][0]), "deg")
    measure("compass.read", float(board.output.latest.get(Quantity.DIP, [-1.0])[0]), "deg")
    measure("compass.now", board.now_s(), "s")
    measure("compass.remarks", len(board.output.remarks()), "")


def test_seen(board, measure):
    measure("compass.clock", board.core_clock_hz, "Hz")
    measure("compass.hard_iron", float(board.truth.hard_iron_ut[0]), "uT")
    measure("compass.calls", board.costs.calls()["tilt"].calls, "")
    measure("compass.samples", -1 if board.costs.samples() is None else 1, "")
"""
VARIABLES = '[device.memory.values]\ndip = { path = "background.count", unit = "deg" }\n'
RIG = (shipped() / "rigs" / "text-compass.toml").read_text(encoding="utf-8").partition("[limits]")[0]
LINES = RIG.replace("\n[field]", '\n[device.text.commands]\npose = "pose\\r\\n"\n\n[field]')
RIGS = {
    "lines": LINES,
    "packets": f'{RIG[: RIG.index("[device]")]}[device]\nkind = "fsflk"\n[device.fsflk]\nalgorithm = "Q9"\n\n'
    f"{RIG[RIG.index('[field]') :]}".replace("compass-lines.elf", "compass-packets.elf"),
    "lines and variables": LINES.replace('kind = "text"', 'kind = ["text", "memory"]').replace(
        "\n[field]", f"\n{VARIABLES}\n[field]"
    ),
    "no byte": RIG.replace("compass-lines.elf", "hiltest-frdm-k64f.elf").partition("[cycles]")[0],
}
# Lines say no dip; it is 62 degrees; in the place of one the rig names a variable that counts two points by then.
READ = {"lines": (-1.0, -1.0), "packets": (60.0, 64.0), "lines and variables": (2.0, 2.0)}
Run = Callable[..., tuple[int, dict[str, Any], str]]


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the suite with options; return exit code, record and output."""
    monkeypatch.delenv("HIL_RIG")

    def run(*options: str, suite: str = SUITE) -> tuple[int, dict[str, Any], str]:
        (pytester.path / "test_bench.py").write_text(suite, encoding="utf-8")
        done = pytester.runpytest_inprocess("test_bench.py", *options)
        record = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
        return int(done.ret), record, " ".join((done.stdout.str() + done.stderr.str()).split())

    return run


@pytest.mark.parametrize("message", RIGS)
def test_a_replay_gives_the_same_record_without_the_firmware(message: str, run: Run, tmp_path: Path) -> None:
    rig = tmp_path / "compass.toml"
    rig.write_text(RIGS[message], encoding="utf-8")
    code, first, output = run(f"--hil-rig={rig}", "--hil-record=run.jsonl")
    assert code == (20 if message == "no byte" else 0), output
    again_code, again, output = run("--hil-replay=run.jsonl")
    assert again_code == code, output
    if message != "no byte":
        assert "replay of virtual FRDM-K64F, seed 1; compass-" in output
        assert again["board"]["kind"] == "replay"
        values = {measurement["name"]: measurement["value"] for measurement in again["measurements"]}
        assert values["compass.said"] >= 10
        low, high = READ[message]
        assert low <= values["compass.read"] <= high
        assert values["compass.calls"] > 10
    volatile = sorted({*first.pop("volatile"), *again.pop("volatile")})
    assert without_volatile({**first, "volatile": volatile}) == without_volatile({**again, "volatile": volatile})


def test_another_command_a_longer_wait_and_a_changed_line_are_found(
    run: Run, tmp_path: Path, pytester: pytest.Pytester
) -> None:
    rig = tmp_path / "compass.toml"
    rig.write_text(LINES, encoding="utf-8")
    assert run(f"--hil-rig={rig}", "--hil-record=run.jsonl")[0] == 0
    code, record, _ = run("--hil-replay=run.jsonl", suite=SUITE.replace("Moment.POSE", "Moment.START"))
    assert code == 20
    assert "test_heard listens to the board, but run.jsonl:" in record["tests"][0]["reason"]
    assert r"in test_bench.py::test_heard sent 'pose\r\n'" in record["tests"][0]["reason"]
    code, record, _ = run("--hil-replay=run.jsonl", suite=SUITE.replace("observe(1.0)", "observe(0.5)"))
    assert code == 20
    assert "test_seen asks costs-1.calls(), but run.jsonl:" in record["tests"][1]["reason"]
    assert "bytes first" in record["tests"][1]["reason"]
    lines = (pytester.path / "run.jsonl").read_text(encoding="utf-8")
    sent = b"pose\r\n".hex()
    assert lines.count(sent) == 1
    (pytester.path / "run.jsonl").write_text(lines.replace(sent, b"hold\r\n".hex()), encoding="utf-8")
    code, record, _ = run("--hil-replay=run.jsonl")
    assert code == 20
    assert r"test_heard sends 'pose\r\n', but run.jsonl:" in record["tests"][0]["reason"]
    assert r"in test_bench.py::test_heard sent 'hold\r\n'" in record["tests"][0]["reason"]


def test_a_variable_of_other_numbers_than_its_quantity_has_is_refused(
    run: Run, tmp_path: Path, pytester: pytest.Pytester
) -> None:
    rig = tmp_path / "compass.toml"
    rig.write_text(RIGS["lines and variables"], encoding="utf-8")
    assert run(f"--hil-rig={rig}", "--hil-record=run.jsonl")[0] == 0
    recorded = (pytester.path / "run.jsonl").read_text(encoding="utf-8")
    assert '"DIP": [2.0]' in recorded
    (pytester.path / "run.jsonl").write_text(recorded.replace('"DIP": [2.0]', '"DIP": [2.0, 2.0]'), encoding="utf-8")
    code, _, output = run("--hil-replay=run.jsonl", "--hil-out=damaged")
    assert code not in (0, 20)
    assert "the recording is damaged: memory reads 2 numbers of dip" in output


@pytest.mark.parametrize(
    ("beyond_deg", "outcome", "code"),
    [(-0.8, "fail", 1), (-0.6, "cannot tell", 22), (0.6, "cannot tell", 22), (0.8, "pass", 0)],
)
def test_a_heading_at_an_angle_that_a_hand_set_is_held_against_its_limit_with_u(
    beyond_deg: float, outcome: str, code: int, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """U is 0.71 degrees, of the table's 0.5 and the mounting's; the limit is so far beyond what was measured."""
    monkeypatch.delenv("HIL_RIG")
    recordings = Path(__file__).parents[2] / "fixtures" / "recordings"
    content = json.loads(gzip.decompress((recordings / "text-by-hand.run.json.gz").read_bytes()))
    (value,) = (
        measurement["value"]
        for measurement in content["measurements"]
        if measurement["name"] == "heading.uncalibrated.max"
    )
    limit = f'"heading.uncalibrated.max" = {{ max = {value + beyond_deg:.3f}, unit = "deg" }}'
    text = (recordings / "text-by-hand.toml").read_text(encoding="utf-8").partition("[limits]")[0]
    (pytester.path / "other.toml").write_text(f"{text}[limits]\n{limit}\n", encoding="utf-8")
    done = pytester.runpytest_inprocess(
        str(shipped() / "suites"),
        "--import-mode=importlib",
        f"--rootdir={pytester.path}",
        "-k",
        "without_calibration",
        f"--hil-replay={recordings / 'text-by-hand.jsonl.gz'}",
        "--hil-rig=other.toml",
        "--hil-out=hil-out",
        plugins=[RunCommand()],
    )
    record = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    (result,) = (
        measurement for measurement in record["measurements"] if measurement["name"] == "heading.uncalibrated.max"
    )
    assert (result["value"], result["outcome"], done.ret) == (value, outcome, code)
    assert result["uncertainty"] == pytest.approx(0.5 * math.sqrt(2.0))
