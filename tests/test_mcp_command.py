"""``hiltest mcp``: the tools of a coding agent, asked by the protocol's own client over stdio."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
from jsonschema import Draft202012Validator
from tests import in_process
from tests.command_files import checked, folder_of_all_inputs, json_schema
from tests.finished_run import Finished
from tests.mcp_client import Answer, Session, ask
from tests.test_written_files import WRITING

from hiltest.commands.cli import every_command
from hiltest.commands.mcp import ANSWER_BYTES, TOOLS
from hiltest.short_documents import compact, shorten

HANG = """
import os, subprocess, time

def test_that_hangs():
    child = subprocess.Popen(["sleep", "1000"])
    with open("children.txt", "w") as file:
        file.write(f"{os.getpid()} {child.pid}")
    while True:
        time.sleep(1)
"""
LOUD = """
import os
import pytest

def test_that_prints(measure):
    os.write(1, b"not a message\\n")
    print("nor this", flush=True)
    measure("compass.slots", 1, "")

@pytest.mark.full
def test_of_the_full_set(measure):
    pass
"""


@pytest.fixture(autouse=True)
def _package(request: pytest.FixtureRequest, require_module: Callable[[str], None]) -> None:
    if request.node.get_closest_marker("slow"):
        require_module("mcp")


def suite(folder: Path, text: str) -> None:
    (folder / "hil" / "suites").mkdir(parents=True)
    (folder / "hil" / "suites" / "test_own.py").write_text(text, encoding="utf-8")


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def children(folder: Path) -> list[int]:
    return [int(number) for number in (folder / "children.txt").read_text().split()]


@pytest.mark.slow
def test_the_parameters_of_a_tool_are_the_options_of_its_command_except_those_that_write(tmp_path: Path) -> None:
    async def talk(session: Session) -> Any:
        return (await session.list_tools()).tools

    tools = {tool.name: tool for tool in ask(talk, tmp_path)}
    assert tuple(tools) == TOOLS
    for name, command in every_command():
        if name not in TOOLS:
            continue
        properties = tools[name].input_schema["properties"]
        options = {max(parameter.opts, key=len).lstrip("-"): parameter for parameter in command.params}
        assert properties.keys() <= options.keys()
        helps = {key: option.help for key, option in options.items() if isinstance(option, click.Option)}
        assert all(properties[key]["description"] == helps.get(key, key.upper()) or key == "out" for key in properties)
        assert "go to pytest" not in tools[name].description, "no tool has arguments for pytest"
        assert "hil-out/OUT" in properties.get("out", {"description": "hil-out/OUT"})["description"]
        writing = {written.rpartition(" --")[2] for written in WRITING if written.startswith(f"{name} --")}
        assert writing.isdisjoint(properties)
        assert tools[name].annotations.read_only_hint == ("out" not in properties)
    assert {"port", "flash", "record", "coverage", "page", "host"}.isdisjoint(tools["run"].input_schema["properties"])
    assert tools["explain"].output_schema["properties"]["schema"]["enum"] == ["hiltest.explanation/1"]


@pytest.mark.ci
def test_an_answer_is_the_document_of_the_command_and_has_its_schema(
    tmp_path_factory: pytest.TempPathFactory, default_run: Finished
) -> None:
    folder = folder_of_all_inputs(tmp_path_factory, default_run)
    calls: list[tuple[str, dict[str, Any], str]] = [
        ("compare", {"base": "run.json", "new": ["dearer.json"]}, "hiltest.comparison/1"),
        ("explain", {"run": "dearer.json", "baseline": "run.json"}, "hiltest.explanation/1"),
        (
            "profile",
            {"elf": "shipped", "function": "crc32", "arguments": ["text:123456789", 9]},
            "hiltest.profile/1",
        ),
        ("judge", {"file": "mine.py:calibrate", "alone": True}, "hiltest.judge/1"),
        ("fit", {"log": "points.csv", "on": "host", "steady": False}, "hiltest.fit/1"),
    ]

    async def talk(session: Session) -> list[Answer]:
        assert "hiltest start" in session.instructions
        return [await session.call_tool(name, arguments) for name, arguments, _ in calls]

    answers = ask(talk, folder, "--out", "tools")
    for answer, (name, _, schema) in zip(answers, calls, strict=True):
        assert not answer.is_error, answer.content[0].text
        assert checked(answer.content[0].text, schema) == answer.structured_content, name
        assert len(answer.content[0].text.encode()) <= ANSWER_BYTES
    changed = answers[0].structured_content["comparisons"][0]["differences"][0]
    assert (changed["name"], changed["change"]) == ("cycles.direct.total", "worse")
    assert answers[2].structured_content["cycles"] == 147  # as docs/profile.md prints
    assert {path.name for path in (folder / "tools" / "judge").iterdir()} == {"judge.json", "judge.html"}


@pytest.mark.slow
def test_an_error_is_told_with_the_sentence_of_the_command_line(tmp_path: Path) -> None:
    calls: list[tuple[str, dict[str, Any], tuple[str, ...]]] = [
        ("profile", {"elf": "gone.elf", "function": "f"}, ("profile", "gone.elf", "f")),
        ("compare", {"base": "gone", "new": ["away"]}, ("compare", "gone", "away")),
        ("run", {"baseline": "gone"}, ("run", "--baseline", "gone")),
        ("run", {"rig": ["gone"]}, ("run", "--rig", "gone")),
        ("run", {"seed": -1}, ("run", "--seed=-1")),
        ("explain", {}, ("explain",)),
    ]

    async def talk(session: Session) -> list[Answer]:
        return [await session.call_tool(name, arguments) for name, arguments, _ in calls]

    for answer, (name, _, words) in zip(ask(talk, tmp_path), calls, strict=True):
        printed = in_process.hiltest(*words, folder=tmp_path).stderr
        assert answer.is_error
        assert f"ERROR: {answer.content[0].text}\n" in printed, name
        assert answer.structured_content["schema"] == "hiltest.error/1"


HOSTILE: list[tuple[str, dict[str, Any], str]] = [
    ("bisect", {}, "no tool 'bisect'; the tools are run, compare, explain, profile, judge, fit"),
    ("run", {"port": "/dev/ttyACM0"}, "run: no parameter 'port'; it has "),
    ("run", {"out": "../elsewhere"}, "out: ../elsewhere is not below "),
    ("judge", {"file": "mine.py:f", "out": "/tmp"}, "out: /tmp is not below "),
    ("run", {"out": "link"}, "out: link is not below "),
    ("run", {"out": ["first", "../second"]}, "out: ../second is not below "),
    ("run", {"seed": ["1", "2"]}, "run: seed has one value, not 2"),
    ("run", {"seeds": "1..100000000"}, "run: 1..100000000 are more than 100 seeds, the most of one call"),
    ("run", {"seeds": "8..1"}, "is not a range of seeds"),
    ("profile", {"elf": "shipped", "function": "f\0g"}, "profile: cannot be started: "),
    ("fit", {"log": "x" * 70_000}, "fit: larger than 65536 bytes, the budget of a tool's arguments"),
    ("compare", {"base": "a", "new": ["b"] * 2000}, "compare: more than 1000 values, the budget of a tool's"),
    ("fit", {"log": {"a": [1]}}, "{'a': [1]}"),
    ("profile", {"elf": "--help", "function": "f"}, "No such option '--help'"),
]


@pytest.mark.slow
def test_a_hostile_call_is_answered_by_an_error_and_the_next_one_as_usual(tmp_path: Path) -> None:
    (tmp_path / "hil-out").mkdir()
    (tmp_path / "hil-out" / "link").symlink_to(tmp_path)

    async def talk(session: Session) -> list[Answer]:
        return [await session.call_tool(name, arguments) for name, arguments, _ in HOSTILE]

    for answer, (_, _, sentence) in zip(ask(talk, tmp_path), HOSTILE, strict=True):
        assert answer.is_error
        assert sentence in answer.content[0].text
    assert {path.name for path in tmp_path.rglob("*")} == {"hil-out", "link"}


@pytest.mark.slow
def test_a_run_writes_below_out_only_and_its_prints_are_no_messages(tmp_path: Path) -> None:
    suite(tmp_path, LOUD)
    (tmp_path / "click.py").write_text("raise RuntimeError('this module is imported instead of the package')\n")
    before = sorted(tmp_path.rglob("*"))

    async def talk(session: Session) -> Answer:
        return await session.call_tool("run", {"out": "first"})

    answer = ask(talk, tmp_path)
    assert not answer.is_error
    assert answer.structured_content == json.loads((tmp_path / "hil-out" / "first" / "run.json").read_text())
    assert answer.structured_content["tests_left_out"] == 1
    assert answer.structured_content == json.loads(answer.content[0].text)
    out = tmp_path / "hil-out"
    assert [path for path in sorted(tmp_path.rglob("*")) if not path.is_relative_to(out)] == before


@pytest.mark.ci
def test_a_run_that_hangs_is_stopped_with_all_its_processes(tmp_path: Path) -> None:
    suite(tmp_path, HANG)

    async def talk(session: Session) -> tuple[Answer, list[int], Answer]:
        answer = await session.call_tool("run", {})
        alive = [process for process in children(tmp_path) if is_alive(process)]
        return answer, alive, await session.call_tool("compare", {"base": "hil-out", "new": ["hil-out"]})

    began = time.monotonic()
    answer, alive, later = ask(talk, tmp_path, "--timeout", "8")
    assert time.monotonic() - began < 60.0  # that of a busy machine; by default it would be 600 s
    assert answer.is_error
    assert answer.content[0].text == "run: stopped after 8 s; hiltest mcp --timeout S allows more"
    assert alive == []
    assert not later.is_error  # Ctrl-C let the run keep its record


def server() -> int:
    """Return the process of the server that this process has started."""
    (process,) = (
        int(number)
        for children in Path("/proc/self/task").glob("*/children")
        for number in children.read_text().split()
        if b"mcp" in Path(f"/proc/{number}/cmdline").read_bytes().split(b"\0")
    )
    return process


@pytest.mark.ci
@pytest.mark.parametrize("ending", ["the call is cancelled", "the connection is closed", "the server is terminated"])
def test_a_run_ends_when(tmp_path: Path, ending: str) -> None:
    import anyio
    from mcp.shared.exceptions import MCPError

    suite(tmp_path, HANG)

    async def talk(session: Session) -> None:
        async def call() -> None:
            with contextlib.suppress(MCPError):  # the connection ends with the server
                await session.call_tool("run", {})

        processes: list[int] = []
        async with anyio.create_task_group() as group:
            group.start_soon(call)
            while len(processes) < 2:
                await anyio.sleep(0.1)
                processes = children(tmp_path) if (tmp_path / "children.txt").exists() else []
            if ending == "the server is terminated":
                processes.append(process := server())
                os.kill(process, signal.SIGTERM)
                await anyio.sleep(2.0)
                assert not any(map(is_alive, processes))
            group.cancel_scope.cancel()
        if ending == "the call is cancelled":
            await anyio.sleep(3.0)  # one of grace, and time for a busy machine
            assert not any(map(is_alive, processes))
            assert (await session.list_tools()).tools

    ask(talk, tmp_path)
    end = time.monotonic() + 5.0
    while any(map(is_alive, children(tmp_path))):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_long_document_is_shortened_to_one_of_the_same_schema(real_record: dict[str, Any]) -> None:
    record = json.loads(json.dumps(real_record))
    worst = next(row for row in record["measurements"] if row["name"] == "heading.iterative.max")
    worst["outcome"] = "fail"
    assert len(compact(record)) > 8 * ANSWER_BYTES
    short = shorten(record, ANSWER_BYTES)
    assert len(compact(short).encode()) <= ANSWER_BYTES
    assert [error.message for error in Draft202012Validator(json_schema("hiltest.run/1")).iter_errors(short)] == []
    assert short["verdict"] == record["verdict"]
    assert short["measurements"][0] == worst
    left_out = short["left_out"]["/measurements"]
    assert len(short["measurements"]) + left_out == len(record["measurements"])
    for table in short["tables"]:
        assert all(len(row) == len(table["columns"]) for row in table["rows"])


def test_a_reason_for_which_many_tests_were_skipped_stands_once_with_their_number() -> None:
    lost = [{"id": f"test_{number}", "outcome": "skipped", "reason": "connection lost"} for number in range(65)]
    others = [
        {"id": "first", "outcome": "wrong firmware", "reason": "no answer"},
        {"id": "other", "outcome": "skipped", "reason": "needs two boards"},
    ]
    short = shorten({"schema": "hiltest.run/1", "tests": [*others, *lost]}, ANSWER_BYTES)
    once = lost[0] | {"reason": "connection lost (also of 64 other tests)"}
    assert short["tests"] == [*others, once]
    assert short["left_out"] == {"/tests": 64}


def test_a_short_document_is_not_changed() -> None:
    document = {"schema": "hiltest.error/1", "rows": [[1, 2], {"outcome": "pass"}, {"outcome": "fail"}]}
    assert shorten(document, ANSWER_BYTES) == document


def test_without_the_package_the_command_names_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcp", None)
    result = in_process.hiltest("mcp", folder=tmp_path)
    assert result.returncode == 4
    assert result.stderr.startswith("ERROR: hiltest mcp needs the package mcp (")
    assert result.stderr.endswith("): pip install 'hiltest[mcp]'\n")
    assert list(tmp_path.iterdir()) == []
