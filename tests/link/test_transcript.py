"""A transcript comes back from its file as it was, or says which line is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.link.transcript import Direction, Transcript, TranscriptEntry


def test_a_transcript_comes_back_from_its_file(tmp_path: Path) -> None:
    transcript = Transcript("virtual")
    transcript.mark(0.0, "test_identity")
    transcript.add(1 / 3, Direction.TO_BOARD, b"\x7e\x01\x7e")
    transcript.add(0.5, Direction.TO_HOST, bytes(range(256)))
    transcript.write(tmp_path / "wire.jsonl")
    again = Transcript.read(tmp_path / "wire.jsonl")
    assert again.clock == "virtual"
    assert again.entries == transcript.entries
    assert again.entries[0] == TranscriptEntry(0.0, Direction.MARK, b"test_identity")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "wire.jsonl:1: schema is None"),
        ("nothing\n", "wire.jsonl:1: no transcript header"),
        ('{"schema": "hiltest.transcript/2"}\n', "schema is 'hiltest.transcript/2'"),
        ('{"schema": "hiltest.transcript/1", "clock": "wall"}\n{"t": 1, "dir": "<", "hex": "7"}\n', "wire.jsonl:2"),
        ('{"schema": "hiltest.transcript/1", "clock": "wall"}\n{"t": 1, "dir": "=", "hex": ""}\n', "wire.jsonl:2"),
    ],
)
def test_a_file_that_is_no_transcript_says_which_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "wire.jsonl").write_text(text)
    with pytest.raises(ConfigError, match=message):
        Transcript.read(tmp_path / "wire.jsonl")
