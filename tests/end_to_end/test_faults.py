"""Every fault of a line and of a board, in a short run: it goes on, or ends as lost in time, with no wrong number."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.end_to_end.fault_tables import PAGE, TABLES, Tried, begin_s, faults_of, row, run, shown
from tests.end_to_end.short_run import DEADLINE_S, Ended, run_short, wrong_numbers
from tests.link.requests import REQUESTS
from tests.patched_firmware import HANG, patched

from hiltest.boards import default_firmware, open_board
from hiltest.errors import DeviceTimeoutError, SyncError
from hiltest.link.request import Request
from hiltest.link.session import ATTEMPTS
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.program.elf import load_image

pytestmark = pytest.mark.slow

# Each ends in another way; the others differ in what the port or the board does.
FEW = (
    "lost bytes",
    "a device that disappears",
    "a stall for good",
    "a brown-out",
    "a magnetometer that is stuck",
    "SDA held low",
)
OPENING = ("command_sync", "command_identity", "command_sensors", "command_select")
ALL = [(heads, tried) for heads, table in TABLES.items() for tried in table]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Ended]:
    runs = {noisy: run_short(tmp_path_factory.mktemp("clean") / "run", noisy=noisy) for noisy in (False, True)}
    assert [item.code for item in runs.values()] == [0, 0]
    return runs


@pytest.mark.parametrize(
    ("heads", "tried"),
    [
        pytest.param(heads, item, id=f"{number}-{item.what}", marks=[] if item.what in FEW else pytest.mark.ci)
        for number, (heads, item) in enumerate(ALL)
    ],
)
def test_a_fault_ends_as_the_page_says_and_leaves_no_wrong_number(
    heads: str, tried: Tried, clean: dict[bool, Ended], tmp_path: Path
) -> None:
    ended, without = run(tmp_path / "run", tried), clean[tried.noisy]
    faults = faults_of(tmp_path / "run")
    assert wrong_numbers(ended, without) == []
    if tried.recovers:
        assert (ended.code, ended.numbers.keys()) == (0, without.numbers.keys())
    else:
        assert ended.code == 20
        assert 0.0 <= ended.virtual_s - begin_s(faults) <= DEADLINE_S
        assert ended.numbers.keys() < without.numbers.keys()
    # Whoever reads the record or the terminal knows that something was spoilt on purpose.
    assert ended.record["rig"]["faults"] == str(faults or "")
    assert faults is None or f"injected faults: {faults}" in ended.output
    assert row(tried, ended, faults, without) in shown(PAGE.read_text(encoding="utf-8"), heads)


@pytest.mark.parametrize("heads", TABLES)
def test_the_page_shows_each_fault_and_no_other(heads: str) -> None:
    rows = shown(PAGE.read_text(encoding="utf-8"), heads).splitlines()[2:]
    assert [item.split("|")[1].strip() for item in rows] == [item.what for item in TABLES[heads]]


@pytest.mark.ci
def test_whichever_command_hangs_its_name_is_said_within_the_deadline(tmp_path: Path) -> None:
    elf, rig = tmp_path / "hangs.elf", load_rig(shipped() / "rigs" / "virtual-k64f.toml")
    functions = load_image(default_firmware()).symbols
    handlers = {function for function in functions if function.startswith("command_")} - {"command_find"}
    named = set()

    def hangs(request: Request[Any]) -> None:
        with open_board(rig, firmware=elf) as board:
            began_s = board.now_s()
            with pytest.raises(DeviceTimeoutError) as raised:
                board.session.request(request)
            assert board.now_s() - began_s <= ATTEMPTS * (1.0 + request.board_time_s) + 1.0
        named.add(str(raised.value).partition("to itself in ")[2].split()[0])

    elf.write_bytes(patched(default_firmware(), handlers - set(OPENING), HANG))
    for request in REQUESTS:
        if request.command not in ("SYNC", "IDENTITY", "SENSORS", "SELECT"):
            hangs(request)
    for handler in OPENING:
        elf.write_bytes(patched(default_firmware(), [handler], HANG))
        with pytest.raises((DeviceTimeoutError, SyncError)) as raised, open_board(rig, firmware=elf):
            pass
        assert handler in str(raised.value) or isinstance(raised.value, SyncError)
        named.add(handler)
    assert named == handlers
