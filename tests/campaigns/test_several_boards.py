"""Several boards run at once: each has its verdict, and one report says how far they are apart."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest
from tests.command_files import run
from tests.test_json_documents import checked

from hiltest.campaigns.several_boards import apart_of, verdict_of
from hiltest.measurement import Limit, Measurement, Outcome, check
from hiltest.report.boards_page import BoardLine, boards_html
from hiltest.rig.bench_files import shipped

VIRTUAL = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
LOST = (shipped() / "rigs" / "served-k64f.toml").read_text(encoding="utf-8")


def a_rig(folder: Path, name: str, text: str, port: str = "") -> str:
    """Write a rig of this name, on a port where one is given."""
    text = re.sub(r"^name = .*", f'name = "{name}"', text, count=1, flags=re.M)
    text = re.sub(r'^port = "socket:.*|^# port = .*', f'port = "{port}"' if port else "", text, count=1, flags=re.M)
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return str(folder / f"{name}.toml")


@pytest.mark.slow
def test_a_board_that_is_lost_leaves_the_others_their_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rigs = [
        a_rig(tmp_path, "left", VIRTUAL),
        a_rig(tmp_path, "right", VIRTUAL),
        a_rig(tmp_path, "gone", LOST, "socket://127.0.0.1:9"),
    ]
    chosen = ("--", "-k", "test_the_worst_cases_that_were_found or test_the_firmware_says_who_it_is or identity")
    assert run("run", *(word for rig in rigs for word in ("--rig", rig)), "--json", *chosen) == 20
    record = checked(capsys.readouterr().out, "hiltest.boards/1")
    assert {board["name"]: board["exit_code"] for board in record["boards"]} == {"left": 0, "right": 0, "gone": 20}
    assert record["sentence"] == "2 of 3 boards pass; gone: connection lost."
    counted = next(
        measurement for measurement in record["measurements"] if measurement["name"] == "cycles.direct.worst_found"
    )
    assert counted["values"]["left"] == counted["values"]["right"] > 0
    assert counted["spread"] == 0
    assert json.loads((tmp_path / "hil-out" / "left" / "run.json").read_text())["verdict"]["exit_code"] == 0
    page = (tmp_path / "hil-out" / "boards.html").read_text(encoding="utf-8")
    assert 'href="./left/report.html"' in page
    assert "gone: connection lost" in (tmp_path / "hil-out" / "boards.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_boards_of_a_batch_have_one_table_and_each_a_label(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    labelled = {}
    for serial in ("K64-7", "K64-8"):
        assert run("run", "--rig", "virtual-k64f", "--serial", serial, "--", "-k", "names_itself") == 0
        labelled[serial] = capsys.readouterr().out.splitlines()[-1]
    for serial, label in labelled.items():
        assert re.fullmatch(
            rf"Label: {serial} \| PASS \| \d{{4}}-\d\d-\d\d \| .+ \| hiltest-frdm-k64f .+ build \w+", label
        )
    record = json.loads((tmp_path / "hil-out" / "K64-8" / "run.json").read_text(encoding="utf-8"))
    assert record["revision"]["label"] == "K64-8"
    summary = checked((tmp_path / "hil-out" / "boards.json").read_text(encoding="utf-8"), "hiltest.boards/1")
    assert [board["name"] for board in summary["boards"]] == ["K64-7", "K64-8"]
    rows = [*csv.DictReader((tmp_path / "hil-out" / "boards.csv").read_text(encoding="utf-8").splitlines())]
    ends = [(row["measurement"], row["K64-7"], row["K64-8"]) for row in rows[:2]]
    assert ends == [("verdict", "pass", "pass"), ("exit code", "0", "0")]
    values = {measurement["name"]: measurement["values"] for measurement in summary["measurements"]}
    assert [row["measurement"] for row in rows[2:]] == list(values)
    assert {float(rows[2][serial]) for serial in labelled} == {*values[rows[2]["measurement"]].values()}
    assert 'href="./K64-7/report.html"' in (tmp_path / "hil-out" / "boards.html").read_text(encoding="utf-8")


def test_a_verdict_that_is_not_evaluated_has_another_sign_than_a_failure() -> None:
    boards = [BoardLine("open", "open", 22, "NOT EVALUATED."), BoardLine("bad", "bad", 1, "FAIL.")]
    near = check("heading.direct.max", 1.6, unit="deg", limit=Limit(max=2), uncertainty=0.7)
    beyond = check("heading.direct.max", 3.0, unit="deg", limit=Limit(max=2), uncertainty=0.7)
    apart = apart_of({"open": [near], "bad": [beyond]})
    open_page, bad_page = (boards_html(verdict_of(chosen), chosen, apart) for chosen in (boards[:1], boards[1:]))
    signs = [
        re.findall(r'class="verdict (\w+)">\s*<h1>[^<]*<strong><span[^>]*>(.)<', page) for page in (open_page, bad_page)
    ]
    assert signs == [[("warn", "!")], [("bad", "✗")]]
    assert re.findall(
        r'class="number (\w+)">(22|1|1\.60 .|3\.00 .)<', boards_html(verdict_of(boards), boards, apart)
    ) == [
        ("warn", "22"),
        ("bad", "1"),
        ("warn", "1.60 ?"),
        ("bad", "3.00 ✗"),
    ]


@pytest.mark.parametrize("serial", ["../x", "a/b", "=1+1", "-x", "", "x" * 65, "a.b"])
def test_a_serial_number_that_is_no_name_is_refused_before_a_run_starts(
    serial: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("run", f"--serial={serial}") == 4
    assert "serial" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--serial", "7"), "--serial is for one board"),
        (("--page",), "--page is for one board"),
        (("--seeds", "1..2"), "--seeds is for one board"),
        (("--against", "old.elf"), "--against is for one board"),
        (("--port", "/dev/ttyACM0"), "--port is for one board"),
        (("--coverage", "lcov.info"), "--coverage is for one board"),
        ((), ""),
    ],
)
def test_what_is_of_one_board_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    other = a_rig(tmp_path, "other", VIRTUAL) if message else a_rig(tmp_path, "virtual-k64f", VIRTUAL)
    assert run("run", "--rig", "virtual-k64f", "--rig", other, *options) == 4
    assert (message or "have the same name") in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.json")), "nothing ran"


@pytest.mark.parametrize(
    ("text", "port", "message"),
    [
        (
            (shipped() / "rigs" / "frdm-k64f.toml").read_text(encoding="utf-8"),
            "/dev/ttyACM0",
            "only one board at a time",
        ),
        (LOST, "socket://127.0.0.1:9", "have the same port, socket://127.0.0.1:9"),
        (LOST, "socket://127.0.0.1:8", "have the same port, socket://127.0.0.1:6465"),
        (LOST, "", "several boards need their ports"),
    ],
    ids=["by hand", "one port", "one table", "no port"],
)
def test_boards_that_cannot_run_at_once_are_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    text: str,
    port: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    rigs = a_rig(tmp_path, "one", LOST, "socket://127.0.0.1:9"), a_rig(tmp_path, "other", text, port)
    assert run("run", "--rig", rigs[0], "--rig", rigs[1]) == 4
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("name", ["..", "../..", "/tmp/x", "a/b", "CON", "x" * 300, "dot."])
def test_a_rig_whose_name_leads_to_another_folder_is_refused_before_a_run_starts(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(re.sub(r"(?m)^name = .*", f'name = "{name}"', VIRTUAL, count=1))
    rigs = str(tmp_path / "rig.toml"), a_rig(tmp_path, "other", VIRTUAL)
    assert run("run", "--rig", rigs[0], "--rig", rigs[1], "--out", "out/deep") == 4
    message = capsys.readouterr().err
    assert "cannot name a file" in message
    assert f"give {rigs[0]} another name" in message
    files = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert files <= {"rig.toml", "other.toml", "command.lock"}


def measured(value: float | None, **more: str) -> Measurement:
    return Measurement(more.get("name", "heading.direct.max"), value, "deg", cycle_model=more.get("model", ""))


def limited(value: float, limit: Limit | None) -> Measurement:
    return Measurement("heading.direct.max", value, "deg", limit=limit, outcome=Outcome.PASS)


def test_the_capability_is_the_room_to_the_nearer_limit_in_three_deviations() -> None:
    numbers = {"a": 0.9, "b": 1.1, "c": 1.3}
    (result,) = apart_of({board: [limited(value, Limit(max=2.0))] for board, value in numbers.items()})
    assert (result.mean, result.deviation) == (pytest.approx(1.1), pytest.approx(0.2))
    assert result.cpk == pytest.approx(0.9 / 0.6)
    assert result.apart == ("0.40", "0.20", "1.50")
    (both,) = apart_of({board: [limited(value, Limit(min=1.0, max=2.0))] for board, value in numbers.items()})
    assert both.cpk == pytest.approx(0.1 / 0.6)
    (out,) = apart_of({board: [limited(value, Limit(max=0.5))] for board, value in numbers.items()})
    assert out.cpk == pytest.approx(-1.0)
    for differ in ((Limit(max=2.0), Limit(max=3.0)), (None, None)):
        (none,) = apart_of({"a": [limited(0.9, differ[0])], "b": [limited(1.1, differ[1])]})
        assert none.cpk is None
        assert none.deviation == pytest.approx(0.1 * 2**0.5)
    (equal,) = apart_of({board: [limited(1.0, Limit(max=2.0))] for board in "ab"})
    assert (equal.deviation, equal.cpk) == (0.0, None)


def test_the_spread_is_of_numbers_that_are_alike() -> None:
    (result,) = apart_of({"a": [measured(0.9)], "b": [measured(1.4)], "c": [measured(None)]})
    assert result.spread == pytest.approx(0.5)
    assert result.values == {"a": 0.9, "b": 1.4, "c": None}
    (alone,) = apart_of({"a": [measured(0.9)], "b": []})
    assert alone.spread is None
    (unlike,) = apart_of({"a": [measured(1.0, model="x")], "b": [measured(2.0, model="y")]})
    assert unlike.spread is None
    sector = "heading.direct.worst_sector"
    (direction,) = apart_of({"a": [measured(330.0, name=sector)], "b": [measured(30.0, name=sector)]})
    assert direction.spread is None


@pytest.mark.parametrize(
    ("codes", "code"), [((0, 0), 0), ((0, 24), 24), ((0, 20, 24), 24), ((1, 20), 1), ((21, 22), 22)]
)
def test_the_first_end_that_applies_is_the_commands_and_a_killed_board_is_no_pass(
    codes: tuple[int, ...], code: int
) -> None:
    boards = [BoardLine(f"board {number}", "", code, "") for number, code in enumerate(codes)]
    assert verdict_of(boards).exit_code == code


def test_what_is_beyond_its_limit_is_marked() -> None:
    failed = Measurement("heading.direct.max", 2.5, "deg", outcome=Outcome.FAIL)
    (result,) = apart_of({"a": [failed], "b": [measured(0.5)]})
    assert (result.cell("a"), result.cell("b"), result.cell("c")) == ("2.50 ✗", "0.50", "")
