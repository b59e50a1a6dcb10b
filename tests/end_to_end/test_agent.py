"""The transcript of docs/mcp.md, played against the real server by the protocol's own client."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.mcp_client import Answer, Session, ask

from .firmware_edits import FirmwareCopy
from .test_regressions import OLD, ONE_NOP_A_POINT

PAGE = (Path(__file__).parents[2] / "docs" / "mcp.md").read_text(encoding="utf-8")
CALLS = [
    tuple(map(json.loads, block.splitlines()))
    for block in re.findall(r'^```json\n(\{"tool".*?)^```', PAGE, re.M | re.S)
]


def contains(whole: Any, part: Any) -> bool:
    """Return whether an answer has all keys and values of an excerpt, and an entry for each of its lists' entries."""
    if isinstance(part, dict):
        return isinstance(whole, dict) and all(key in whole and contains(whole[key], part[key]) for key in part)
    if isinstance(part, list):
        return isinstance(whole, list) and all(any(contains(item, entry) for item in whole) for entry in part)
    return bool(whole == part)


def test_an_agent_learns_in_at_most_six_calls_that_a_build_is_worse_and_in_which_line(
    tmp_path: Path, copy_of_the_firmware: FirmwareCopy, require_module: Callable[[str], None]
) -> None:
    require_module("mcp")
    shutil.copy(OLD, tmp_path / "old.elf")
    copy_of_the_firmware.build(ONE_NOP_A_POINT, tmp_path / "new.elf")

    async def talk(session: Session) -> list[Answer]:
        return [await session.call_tool(call["tool"], call["arguments"]) for call, _ in CALLS]

    answers = ask(talk, tmp_path)
    assert 1 < len(answers) <= 6
    for answer, (call, excerpt) in zip(answers, CALLS, strict=True):
        assert not answer.is_error, answer.content[0].text
        assert contains(answer.structured_content, excerpt), (call, answer.content[0].text)
    explanation = answers[-1].structured_content
    assert explanation["sentence"].startswith("Not to be merged")
    (comparison,) = answers[-2].structured_content["comparisons"]
    assert comparison["sentence"] == explanation["sentence"]
    assert {row["change"] for row in comparison["differences"][:7]} == {"worse"}  # as many as the sentence names
    # The largest change is the line that the edit added.
    source = (Path(__file__).parents[2] / "firmware_stub" / ONE_NOP_A_POINT.file).read_text(encoding="utf-8")
    line = source.replace(ONE_NOP_A_POINT.old, ONE_NOP_A_POINT.new).split('__asm__ volatile("nop")')[0].count("\n") + 1
    assert {function["lines"][0]["location"] for function in explanation["functions"]} == {f"moments.c:{line}"}
    assert {path.name for path in tmp_path.iterdir()} == {"old.elf", "new.elf", "hil-out"}
