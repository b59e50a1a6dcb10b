"""Names from files and other machines become paths in their folder, or are refused by name."""

from __future__ import annotations

import gzip
import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from hiltest.campaigns.sent_bench import RemoteResult
from hiltest.errors import ConfigError
from hiltest.link.transcript import Direction
from hiltest.path_names import path_below, path_in
from hiltest.session.wire_traces import WireTraces
from hiltest.tape.recorded_run import read_transcript

NAMES = ["", ".", "..", "...", "/etc", "a/b", "a\\b", "C:", "a\0", "a\n", "nul", "COM1.json", "x.", "x ", "y" * 201]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_leads_elsewhere_is_refused_with_the_next_step(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot name a file: name another$"):
        path_in(tmp_path, name, remedy="name another")


def test_an_ordinary_name_is_a_path_in_the_folder_unless_it_is_a_link_there(tmp_path: Path) -> None:
    for name in ("rig", ".hidden", "virtual k64f", "h\u00e4", "console", "a..b"):
        assert path_in(tmp_path, name, remedy="") == tmp_path / name
    (tmp_path / "rig").symlink_to("/etc")
    with pytest.raises(ConfigError, match=f"'rig' is a link in {tmp_path}"):
        path_in(tmp_path, "rig", remedy="")
    with pytest.raises(ConfigError, match="'rig' is a link"):
        path_below(tmp_path, "rig/passwd", remedy="")


@pytest.mark.parametrize("name", ["../stolen", "/tmp/stolen", "traces/../../stolen", "traces/nul"])
def test_a_worker_whose_files_lead_elsewhere_writes_none_of_them(name: str, tmp_path: Path) -> None:
    result = RemoteResult(0, "", {"report.html": b"page", name: b"stolen"})
    with pytest.raises(ConfigError, match="the worker is not to be trusted"):
        result.write(tmp_path / "out" / "seed-0001")
    assert list(tmp_path.iterdir()) == []


def test_a_trace_is_not_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "traces").symlink_to(tmp_path / "elsewhere")
    traces = WireTraces(tmp_path / "out")
    traces.transcript.add(1.0, Direction.TO_BOARD, b"x")
    assert traces.keep("test_a", "call", ValueError(), about="a board") == ""
    assert list((tmp_path / "elsewhere").iterdir()) == []
    (tmp_path / "out" / "traces").unlink()
    assert (tmp_path / "out" / traces.keep("test_a", "call", ValueError(), about="a board")).exists()


@pytest.mark.parametrize("name", ["/home/../etc/rig.toml", "C:\\rigs\\..\\rig.toml", "rig\x1b[2J.toml", "a\nb"])
def test_a_recording_whose_rig_leads_elsewhere_is_refused_and_one_from_any_system_is_not(
    name: str, tmp_path: Path
) -> None:
    recording = Path(__file__).parents[1] / "fixtures" / "recordings" / "by-hand.jsonl.gz"
    header, _, rest = gzip.decompress(recording.read_bytes()).partition(b"\n")
    content = json.loads(header)
    for rig_file, refused in ((name, True), ("C:\\bench\\rig.toml", False)):
        content["recorded"]["rig_file"] = rig_file
        path = tmp_path / "other.jsonl"
        path.write_bytes(json.dumps(content).encode() + b"\n" + rest)
        with pytest.raises(ConfigError, match="leads elsewhere") if refused else nullcontext():
            assert read_transcript(path)[0].rig_file == rig_file
