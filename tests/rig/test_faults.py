"""The table [faults]: read, refused, in words, and one of the conditions of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.errors import ConfigError, UnknownKeyError
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.board_faults import BoardReset, HeldLine, SensorFault
from hiltest.rig.faults import Absence, Faults, Late, OtherBaud, Span
from hiltest.rig.rig import conditions_sha256
from hiltest.rig.rig_file import load_rig

DEFAULT = shipped() / "rigs" / "virtual-k64f.toml"
ALL = """
seed = 7
direction = "to-board"
after_s = 0.5
lose = 1e-3
double = 2e-3
flip = 3e-3
split = 4e-3
late = { probability = 5e-3, by_s = 0.3 }
stall = { after_s = 1.0, for_s = 2.0 }
disappear = { after_s = 3.0, back_after_s = 4.0 }
baud = { after_s = 5.0, to = 57_600 }
full_output = { after_s = 6.0, for_s = 0.5 }
sensor = { part = "mag3110", fault = "frozen", after_s = 7.0 }
held_line = { bus = 1, line = "sda", after_s = 8.0, for_s = 0.25 }
reset = { by = "brown-out", after_s = 9.0 }
"""


def add_faults(folder: Path, table: str) -> Rig:
    path = folder / "rig.toml"
    path.write_text(f"{DEFAULT.read_text(encoding='utf-8')}\n[faults]\n{table}", encoding="utf-8")
    return load_rig(path)


def test_every_fault_is_read_and_said_in_words(tmp_path: Path) -> None:
    faults = add_faults(tmp_path, ALL).faults
    assert faults == Faults(
        seed=7,
        direction="to-board",
        after_s=0.5,
        lose=1e-3,
        double=2e-3,
        flip=3e-3,
        split=4e-3,
        late=Late(5e-3, 0.3),
        stall=Span(1.0, 2.0),
        disappear=Absence(3.0, 4.0),
        baud=OtherBaud(5.0, 57_600),
        full_output=Span(6.0, 0.5),
        sensor=SensorFault("mag3110", "frozen", 7.0),
        held_line=HeldLine(1, "sda", 8.0, 0.25),
        reset=BoardReset("brown-out", 9.0),
    )
    assert str(faults) == (
        "mag3110: frozen after 7 s; SDA of I2C1 held low after 8 s for 0.25 s; a brown-out after 9 s; "
        "0.001 of bytes lost, 0.002 of bytes doubled, 0.003 of bytes with a wrong bit, 0.004 of bytes the last of a "
        "piece, 0.005 of bytes late by 0.3 s, a stall after 1 s for 2 s, gone after 3 s, back after 4 s, 57600 baud "
        "after 5 s, a full output buffer after 6 s for 0.5 s; on the way to the board after 0.5 s, seed 7"
    )


def test_faults_are_one_of_the_conditions_and_none_leaves_them_as_they_were(tmp_path: Path) -> None:
    digests = {conditions_sha256(add_faults(tmp_path, table)) for table in ("lose = 1e-3", "lose = 2e-3", ALL)}
    assert len(digests | {conditions_sha256(load_rig(DEFAULT))}) == 4
    assert load_rig(DEFAULT).faults is None


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        ("", "faults.seed", "has no fault"),
        ("seed = 2", "faults.seed", "has no fault"),
        ("lose = 1.5", "faults.lose", "is a probability"),
        ("flip = -0.1", "faults.flip", "is a probability"),
        ("lose = 0.5\nflip = 0.6", "faults.lose", "exceed 1"),
        ("lose = true", "faults.lose", "not true"),
        ('direction = "up"\nlose = 0.1', "faults.direction", "'to-board'"),
        ("late = { probability = 0.0, by_s = 1.0 }", "faults.late.probability", "above 0"),
        ("late = { probability = 0.1, by_s = 0.0 }", "faults.late.by_s", "above 0"),
        ('sensor = { part = "lsm303", fault = "absent" }', "faults.sensor.part", "is none of mag3110"),
        ('sensor = { part = "mag3110", fault = "tired" }', "faults.sensor.fault", "'other part'"),
        ('held_line = { bus = 2, line = "sda" }', "faults.held_line.bus", "0 or 1"),
        ('held_line = { bus = 1, line = "sda", for_s = 0.0 }', "faults.held_line.for_s", "above 0"),
        ('reset = { by = "button", after_s = -1.0 }', "faults.reset.after_s", "must be 0 to"),
        ("stall = { after_s = -1.0, for_s = 1.0 }", "faults.stall.after_s", "must be 0 to"),
        ("stall = { after_s = 1.0, for_s = 0.0 }", "faults.stall.for_s", "above 0"),
        ("stall = { after_s = 1.0 }", "faults.stall.for_s", "is missing"),
        ("disappear = { after_s = 2.0, back_after_s = 1.0 }", "faults.disappear.back_after_s", "above after_s"),
        ("baud = { after_s = 1.0, to = 0 }", "faults.baud.to", "must be 50 to"),
        ('direction = "to-host"\nfull_output = { after_s = 1.0, for_s = 1.0 }', "faults.full_output", "to the board"),
    ],
)
def test_a_wrong_value_is_named_with_file_line_and_key(tmp_path: Path, table: str, key: str, words: str) -> None:
    with pytest.raises(ConfigError, match=r"rig\.toml:\d+: ") as caught:
        add_faults(tmp_path, table)
    assert key in str(caught.value)
    assert words in str(caught.value)


def test_an_unknown_key_is_named_with_the_nearest_known_one(tmp_path: Path) -> None:
    with pytest.raises(UnknownKeyError, match="did you mean 'lose'"):
        add_faults(tmp_path, "loose = 0.1")


def test_faults_of_a_board_are_of_a_virtual_one_and_of_a_part_that_it_has(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    real = (shipped() / "rigs" / "frdm-k64f.toml").read_text(encoding="utf-8")
    rig.write_text(f'{real}\n[faults]\nreset = {{ by = "button", after_s = 1.0 }}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r'faults: .*reset require a board of kind "virtual"'):
        load_rig(rig)
    bare = DEFAULT.read_text(encoding="utf-8").replace("[world]\n", '[world]\nfitted = ["fxos8700cq", "mag3110"]\n', 1)
    rig.write_text(f'{bare}\n[faults]\nsensor = {{ part = "fxas21002c", fault = "absent" }}\n', encoding="utf-8")
    with pytest.raises(
        ConfigError,
        match=r"faults\.sensor\.part: is none of fxos8700cq, mag3110:",
    ):
        load_rig(rig)
