"""A run that is to be judged against a base passes only when it was, whatever keeps tests from running."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from hiltest.boards import default_firmware

from ..in_process import hiltest

LAMP = """
import os
import pytest
from hiltest.measurement import Limit

def test_first(board):
    pass

def test_current(measure, board):
    measure("lamp.current", float(os.environ.get("LAMP_CURRENT", 2)), "mA", limit=Limit(max=9))

def test_life(measure, board):
    if "LAMP_BROKEN" not in os.environ:
        measure("lamp.life", 30.0, "h")
"""
FAILS = "\ndef test_first(board):\n    assert 'LAMP_FAILS' not in os.environ\n"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the first test that needs it keeps the record of a lamp that draws 2 mA."""
    return tmp_path_factory.mktemp("recorded") / "base"


@pytest.fixture
def base(pytester: pytest.Pytester, recorded: Path) -> Path:
    """A lamp that draws 2 mA, and the record of it."""
    pytester.makepyfile(test_lamp=LAMP)
    if not recorded.exists():
        assert pytester.runpytest_inprocess(f"--hil-out={recorded}").ret == 0
    return shutil.copytree(recorded, pytester.path / "base")


def record(pytester: pytest.Pytester) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return content


def judged(pytester: pytest.Pytester, *options: str, base: str = "base") -> tuple[int, str]:
    """Run against the base; return exit code and sentence."""
    result = pytester.runpytest_inprocess(f"--hil-baseline={base}", *options)
    return int(result.ret), str(record(pytester)["verdict"]["sentence"])


@pytest.mark.usefixtures("base")
@pytest.mark.parametrize(
    ("current", "code", "change"),
    [
        ("2", 0, "unchanged"),
        ("1", 0, "better"),
        ("3", 21, "worse"),
        ("10", 1, "worse"),  # out of its limit is a failed test, and that comes first
    ],
)
def test_it_says_what_changed_and_whether_it_may_be_merged(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, current: str, code: int, change: str
) -> None:
    monkeypatch.setenv("LAMP_CURRENT", current)
    assert judged(pytester)[0] == code
    changes = {difference["name"]: difference["change"] for difference in record(pytester)["comparison"]["differences"]}
    unchanged = dict.fromkeys(("lamp.life", "firmware.flash", "firmware.ram"), "unchanged")
    assert changes == {"lamp.current": change, **unchanged}


def test_the_base_may_lie_where_the_record_will(base: Path, pytester: pytest.Pytester) -> None:
    base.rename(pytester.path / "hil-out")
    assert pytester.runpytest_inprocess("--hil-baseline=hil-out/run.json").ret == 0


def test_the_record_keeps_the_headings_of_the_base_for_its_picture(base: Path, pytester: pytest.Pytester) -> None:
    content = json.loads((base / "run.json").read_text(encoding="utf-8"))
    columns = [{"name": "heading", "unit": "deg"}, {"name": "error.direct", "unit": "deg"}]
    content["tables"] = [{"name": "heading.poses", "columns": columns, "rows": [[0.0, 0.5], [90.0, -0.5]]}]
    (base / "run.json").write_text(json.dumps(content), encoding="utf-8")
    assert judged(pytester)[0] == 0
    (table,) = (table for table in record(pytester)["tables"] if table["name"] == "heading.base_poses")
    assert table["rows"] == [[0.0, 0.5], [90.0, -0.5]]


def test_the_base_may_come_from_environment_and_ini(
    base: Path, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LAMP_CURRENT", "3")
    pytester.makeini("[pytest]\nhil_baseline = base\n")
    assert pytester.runpytest_inprocess().ret == 21
    assert pytester.runpytest_inprocess("-o", "hil_baseline=").ret == 0
    monkeypatch.setenv("HIL_BASELINE", "no-such-file.json")
    assert pytester.runpytest_inprocess().ret == 4


def test_a_base_that_missed_a_limit_is_a_base_and_one_that_lost_its_bench_is_none(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytester.makepyfile(test_lamp=LAMP)
    monkeypatch.setenv("LAMP_CURRENT", "10")
    assert pytester.runpytest_inprocess("--hil-out=base").ret == 1
    monkeypatch.delenv("LAMP_CURRENT")
    code, sentence = judged(pytester)
    assert code == 0
    assert "1 better: lamp.current 10 -> 2 mA" in sentence
    lost = "\ndef test_life(board):\n    raise LinkLostError('p', 'gone')\n"
    pytester.makepyfile(test_lamp="from hiltest.errors import LinkLostError\n" + LAMP + lost)
    assert pytester.runpytest_inprocess("--hil-out=base").ret == 20
    pytester.makepyfile(test_lamp=LAMP)
    code, sentence = judged(pytester)
    assert code == 22
    assert "base/run.json: the run is incomplete (connection lost)" in sentence


@pytest.mark.usefixtures("base")
def test_another_rig_is_no_pass_and_another_limit_is_the_same_rig(
    pytester: pytest.Pytester, default_rig: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = default_rig[: default_rig.index("[limits]")]
    path = pytester.path / "lamp.toml"
    monkeypatch.setenv("HIL_RIG", "lamp.toml")
    path.write_text(rig + '[limits]\n"lamp.life" = { min = 20.0, unit = "h" }\n', encoding="utf-8")
    assert judged(pytester)[0] == 0
    path.write_text(rig.replace("dip_deg = 62.0 ", "dip_deg = 61.0 "), encoding="utf-8")
    code, sentence = judged(pytester)
    assert code == 22
    assert "another rig: " in sentence


@pytest.mark.parametrize("saved", [False, True], ids=["a run", "a baseline"])
def test_a_tolerance_that_is_edited_with_the_change_hides_nothing(
    pytester: pytest.Pytester, default_rig: str, monkeypatch: pytest.MonkeyPatch, saved: bool
) -> None:
    rig = default_rig[: default_rig.index("[limits]")]
    (pytester.path / "lamp.toml").write_text(rig, encoding="utf-8")
    monkeypatch.setenv("HIL_RIG", "lamp.toml")
    pytester.makepyfile(test_lamp=LAMP)
    assert pytester.runpytest_inprocess("--hil-out=base").ret == 0
    if saved:
        assert hiltest("baseline", "save", "base", "base.json").returncode == 0
    tolerance = '[tolerances]\n"lamp.current" = { absolute = 5.0, unit = "mA" }\n'
    (pytester.path / "lamp.toml").write_text(rig + tolerance, encoding="utf-8")
    monkeypatch.setenv("LAMP_CURRENT", "3")
    base = "base.json" if saved else "base"
    code, sentence = judged(pytester, base=base)
    assert code == 21
    assert "lamp.current 2 -> 3 mA (+1, +50 %; limit at most 9; its tolerance was exact in the base)" in sentence
    if saved:  # the tolerance is changed as a number is: by name and with a reason
        accepted = hiltest(
            "baseline",
            "update",
            "base.json",
            "hil-out",
            "--accept",
            "lamp.current",
            "--because",
            "another lamp",
        )
        assert "lamp.current: 2 -> 3; tolerance exact -> 5 mA" in accepted.stdout.splitlines()
        monkeypatch.setenv("LAMP_CURRENT", "4")
        assert judged(pytester, base=base)[0] == 0


@pytest.mark.usefixtures("base")
@pytest.mark.parametrize("options", [["-k", "current or first"], ["test_lamp.py::test_current"]], ids=["-k", "node id"])
def test_a_choice_of_tests_is_no_pass(pytester: pytest.Pytester, options: list[str]) -> None:
    code, sentence = judged(pytester, *options)
    assert code == 22
    assert "this run: only chosen tests ran, without 1 measurement of base/run.json" in sentence.replace(
        "this run of hiltest-frdm-k64f 0.1.0", "this run"
    )


@pytest.mark.parametrize(
    ("options", "chosen"),
    [
        ((), False),
        (("-k", "current"), True),
        (("test_lamp.py::test_current",), True),
        (("--deselect=test_lamp.py::test_life",), True),
        (("-m", "not plain"), False),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_choice_of_tests_is_no_baseline_and_no_base_of_a_whole_run(
    pytester: pytest.Pytester, options: tuple[str, ...], chosen: bool
) -> None:
    pytester.makepyfile(test_lamp=LAMP + "\n@pytest.mark.plain\ndef test_plain():\n    pass\n")
    pytester.makeini("[pytest]\nmarkers =\n    plain: of no bench\n")
    assert pytester.runpytest_inprocess("--hil-out=base", *options).ret == 0
    saved = hiltest("baseline", "save", "base", "base.json")
    assert saved.returncode == (4 if chosen else 0)
    if chosen:
        assert "only chosen tests ran" in saved.stderr
    code, sentence = judged(pytester)
    assert code == (22 if chosen else 0)
    assert ("base/run.json: only chosen tests ran before" in sentence) is chosen
    if not options:
        assert sentence.startswith("May be merged (against base")
    if options == ("-k", "current"):
        shutil.rmtree(pytester.path / "hil-out")  # of a complete run, which chosen tests would leave as it is
        code, sentence = judged(pytester, *options)
        assert code == 0
        assert "May be merged as far as the chosen tests show (against base" in sentence


@pytest.mark.usefixtures("base")
def test_a_choice_that_leaves_no_test_of_hiltest_is_no_pass(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_plain="def test_plain():\n    pass\n")
    result = pytester.runpytest_inprocess("--hil-baseline=base", "-k", "plain")
    assert result.ret == 22
    result.stdout.fnmatch_lines(
        ["NOT EVALUATED: --hil-baseline is base, and no test that ran uses hiltest, so there is nothing to compare."]
    )
    assert pytester.runpytest_inprocess("--hil-baseline=base", "-k", "nothing").ret == 5


@pytest.mark.usefixtures("base")
@pytest.mark.parametrize(
    ("look", "by"),
    [
        *((text, "option") for text in ("--collect-only", "--fixtures", "--fixtures-per-test", "--markers", "--help")),
        ("--collect-only", "PYTEST_ADDOPTS"),
    ],
)
def test_who_only_looks_at_tests_has_judged_nothing(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, look: str, by: str
) -> None:
    options = [look] if by == "option" else []
    if not options:
        monkeypatch.setenv("PYTEST_ADDOPTS", look)
    result = pytester.runpytest_inprocess("--hil-baseline=base", *options)
    assert result.ret == 22
    assert (
        result.outlines[-1] == "NOT EVALUATED: --hil-baseline is base, and no test ran, so there is nothing to compare."
    )
    assert not (pytester.path / "hil-out").exists()
    assert pytester.runpytest_inprocess(*options).ret == 0


@pytest.mark.usefixtures("base")
@pytest.mark.parametrize("option", ["-x", "--maxfail=1"])
def test_stopping_at_the_first_failure_is_no_pass_and_no_comparison(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, option: str
) -> None:
    pytester.makepyfile(test_lamp=LAMP + FAILS)
    monkeypatch.setenv("LAMP_FAILS", "yes")
    code, sentence = judged(pytester, option)
    assert code == 1
    assert sentence.startswith("Not to be merged (against base/run.json): FAIL. Failed: test_lamp.py::test_first (")
    assert " Changes: not compared: this run: the run is incomplete (fail)" in sentence
    assert " not taken;" in sentence
    assert not record(pytester)["verdict"]["complete"]


@pytest.mark.usefixtures("base")
def test_a_session_that_ends_itself_with_0_is_no_pass(pytester: pytest.Pytester) -> None:
    quits = "\ndef test_life(board):\n    pytest.exit('enough', returncode=0)\n"
    pytester.makepyfile(test_lamp=LAMP + quits)
    code, sentence = judged(pytester)
    assert code == 22
    assert "this run: the run is incomplete" in sentence


@pytest.mark.usefixtures("base")
def test_two_workers_are_judged_as_one_process_is(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xdist")
    monkeypatch.setenv("LAMP_CURRENT", "3")
    assert pytester.runpytest_inprocess("--hil-baseline=base", "-n2", "--dist=loadgroup").ret == 21
    assert [test["outcome"] for test in record(pytester)["tests"]] == ["passed"] * 3


@pytest.mark.usefixtures("base")
def test_ctrl_c_is_interrupted_and_not_compared(pytester: pytest.Pytester) -> None:
    waits = "\ndef test_life(board):\n    import time\n    open('waiting', 'w').close()\n    time.sleep(60)\n"
    pytester.makepyfile(test_lamp=LAMP + waits)
    command = [sys.executable, "-m", "pytest", "--hil-baseline=base", "-p", "no:cacheprovider"]
    with subprocess.Popen(command, cwd=pytester.path, stdout=subprocess.DEVNULL, env=os.environ) as running:
        ends_s = time.monotonic() + 60.0
        while not (pytester.path / "waiting").exists() and running.poll() is None and time.monotonic() < ends_s:
            time.sleep(0.02)
        running.send_signal(signal.SIGINT)
        assert running.wait(60.0) == 2
    sentence = record(pytester)["verdict"]["sentence"]
    answer = "Cannot say whether it may be merged (against base/run.json): INTERRUPTED: this run: the run is incompl"
    assert sentence.startswith(answer)


@pytest.mark.usefixtures("base")
@pytest.mark.parametrize("workers", [(), ("-n2",)], ids=["one process", "workers"])
def test_a_base_that_does_not_exist_is_a_usage_error(pytester: pytest.Pytester, workers: tuple[str, ...]) -> None:
    result = pytester.runpytest_inprocess("--hil-baseline=no-such.json", *workers)
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: no-such.json: No such file or directory; name a run.json, *"])
    assert not (pytester.path / "hil-out").exists()


@pytest.mark.usefixtures("base")
def test_without_its_base_no_test_runs_and_the_record_says_why(pytester: pytest.Pytester) -> None:
    (pytester.path / "damaged.json").write_text("no json", encoding="utf-8")
    result = pytester.runpytest_inprocess("--hil-baseline=damaged.json")
    assert result.ret == 22
    answer = " ".join(" ".join(result.outlines).split())
    assert "(against damaged.json): NOT EVALUATED: damaged.json: not JSON:" in answer
    assert record(pytester)["tests"] == []
    assert not record(pytester)["verdict"]["complete"]


def test_what_an_earlier_command_compared_with_does_not_stay_in_the_folder(
    base: Path, pytester: pytest.Pytester
) -> None:
    shutil.copytree(base, pytester.path / "hil-out" / "against")
    shutil.copytree(base, pytester.path / "hil-out" / "against" / "seed-0001")
    assert pytester.runpytest_inprocess("--hil-baseline=hil-out/against/run.json").ret == 0, "it was read before"
    assert not (pytester.path / "hil-out" / "against").exists()


WITHOUT_A_BOARD = """
import os

def test_size(measure):
    measure("table.bytes", int(os.environ.get("TABLE_BYTES", 100)), "B")

def test_cost(measure):
    if "NO_COST" not in os.environ:
        cycles, model = int(os.environ.get("CRC_CYCLES", 420)), os.environ.get("MODEL", "cortex-m4-trm/3@sram")
        measure("crc.cycles", cycles, "cycle", cycle_model=model)
"""


@pytest.fixture
def no_board(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests that measure and need neither board nor rig, and the record of them."""
    monkeypatch.delenv("HIL_RIG")
    pytester.makepyfile(test_lamp=WITHOUT_A_BOARD)
    assert pytester.runpytest_inprocess("--hil-out=base").ret == 0


@pytest.mark.usefixtures("no_board")
@pytest.mark.parametrize("saved", [False, True], ids=["a run", "a baseline"])
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ({}, 0, "May be merged (against {base}): PASS: 2 unchanged."),
        ({"TABLE_BYTES": "140"}, 0, "1 changed"),
        ({"NO_COST": "yes"}, 22, "measurement missing: crc.cycles"),
        ({"MODEL": "silicon-dwt"}, 22, "measurement missing: crc.cycles (the cycle model was"),
        ({"CRC_CYCLES": "421"}, 21, "1 worse: crc.cycles 420 -> 421 cycles"),
    ],
    ids=["as it was", "changed", "gone", "another cycle model", "worse"],
)
def test_a_run_that_needs_no_board_is_judged_as_any_other(
    pytester: pytest.Pytester,
    monkeypatch: pytest.MonkeyPatch,
    arguments: dict[str, str],
    code: int,
    words: str,
    saved: bool,
) -> None:
    if saved:
        assert hiltest("baseline", "save", "base", "base.json").returncode == 0
    for name, value in arguments.items():
        monkeypatch.setenv(name, value)
    base = "base.json" if saved else "base/run.json"
    ended, sentence = judged(pytester, base=base)
    assert ended == code, sentence
    assert words.format(base=base) in sentence


@pytest.mark.usefixtures("no_board")
def test_a_run_on_a_board_is_not_compared_with_one_that_needs_none(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_lamp=WITHOUT_A_BOARD + "\ndef test_board(board):\n    pass\n")
    code, sentence = judged(pytester)
    assert code == 22
    assert "another kind of board: none before, virtual now" in sentence


@pytest.mark.usefixtures("base")
def test_the_answer_stands_before_the_worst_change_wherever_the_page_says(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LAMP_CURRENT", "3")
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    result = pytester.runpytest_inprocess("--hil-baseline=base")
    answer = "Not to be merged (against base/run.json): "
    change = "lamp.current 2 -> 3 mA (+1, +50 %; limit at most 9)"
    page, markdown = ((pytester.path / "hil-out" / f"report.{kind}").read_text("utf-8") for kind in ("html", "md"))
    (annotation,) = [line for line in result.outlines if line.startswith("::error ")]
    printed = " ".join(line for line in result.outlines if not line.startswith("::"))
    texts = [unescape(page).replace("\N{NO-BREAK SPACE}", " "), re.sub(r"\\(.)", r"\1", markdown)]
    for text in (" ".join(printed.split()), annotation.replace("%25", "%"), *texts):
        assert text.index(f"{answer}REGRESSION") < text.index(change)
    compared = hiltest("compare", "base", "hil-out")
    assert f"{answer}1 worse: {change}" in compared.stdout


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('"values": [2.0]', '"values": [3.0]'),
        ('"absolute": 0.0', '"absolute": 1000000000.0'),
        (' {"name": "lamp.current"', ' {"name": "lamp.other"'),
        ('"digest": "', '"digest": "0'),
        ('"digest":', '"was_digest":'),
    ],
    ids=["a value", "a tolerance", "a name", "the digest", "no digest"],
)
@pytest.mark.usefixtures("base")
def test_an_edited_baseline_is_no_base_and_the_line_to_run_makes_it_one(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, before: str, after: str
) -> None:
    assert hiltest("baseline", "save", "base", "base.json").returncode == 0
    text = (pytester.path / "base.json").read_text(encoding="utf-8")
    assert before in text
    (pytester.path / "base.json").write_text(text.replace(before, after, 1), encoding="utf-8")
    monkeypatch.setenv("LAMP_CURRENT", "3")
    code, sentence = judged(pytester, base="base.json")
    assert (code, record(pytester)["tests"]) == (22, [])
    (command,) = re.findall(r"\(hiltest (baseline save RUN base\.json)\)", sentence)
    assert hiltest(*command.replace("RUN", "base").split()).returncode == 0
    assert judged(pytester, base="base.json")[0] == 21


@pytest.mark.usefixtures("base")
def test_the_files_of_tests_that_differ_from_the_baseline_are_named(pytester: pytest.Pytester) -> None:
    assert hiltest("baseline", "save", "base", "base.json").returncode == 0
    assert judged(pytester, base="base.json")[0] == 0
    assert "Tests differ" not in record(pytester)["comparison"]["remark"]
    pytester.makeconftest("")
    pytester.makepyfile(test_lamp=LAMP + "# edited\n")
    assert judged(pytester, base="base.json")[0] == 0
    remark = record(pytester)["comparison"]["remark"]
    assert remark.endswith("Tests differ from those of the base: ./conftest.py, test_lamp.py.")


@pytest.mark.usefixtures("base")
@pytest.mark.parametrize("by", ["", "option", "environment"])
def test_a_gate_on_the_packaged_firmware_says_so_where_nobody_named_one(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    if by == "environment":
        monkeypatch.setenv("HIL_FIRMWARE", str(default_firmware()))
    options = [f"--hil-firmware={default_firmware()}"] if by == "option" else []
    result = pytester.runpytest_inprocess("--hil-baseline=base", *options)
    assert result.ret == 0
    remark = "The packaged firmware was compared: name yours with --firmware ELF."
    assert (remark in result.stdout.str()) is not bool(by)
    same = "Both sides ran the same firmware file."
    assert record(pytester)["comparison"]["remark"] == (same if by else f"{remark} {same}")
    assert (remark in (pytester.path / "hil-out" / "report.html").read_text(encoding="utf-8")) is not bool(by)
