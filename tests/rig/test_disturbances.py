"""The tables of a rig that disturb the field: what they make, and what is said about wrong ones."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import ConfigError, UnknownKeyError
from hiltest.rig import build_world
from hiltest.rig.disturbances import CableTable, CurrentTable, PassingTable
from hiltest.rig.rig import conditions_sha256
from hiltest.rig.rig_file import load_rig

DEFAULT = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
CURRENT = """
[world.current]
field_ut_per_a = [0.9, -0.4, 0.3]
waveform = [[45, 0], [45.5, 8], [60, 8], [60.5, 0]]
"""
PASSING = """
[world.passing]
moment_am2 = [300, 0, 100]
place_m = [0, 2, 0.5]
velocity_mps = [1.5, 0, 0]
at_s = 70
"""
CABLE = """
[world.cable]
current_a = 10
direction = [1, 0, 0]
places = [[80, 0, 0.1, 0.3], [80, 0, 0.1, 0.15], [90, 0, 0.1, 0.15], [91, 0, 0.1, 0.3]]
"""


@pytest.fixture
def with_tables(tmp_path):
    """Return a function that loads the default rig with tables of its world added, of which one text is replaced."""

    def load(tables, old="", new=""):
        text = DEFAULT.read_text(encoding="utf-8")
        path = tmp_path / "bench.toml"
        assert not old or tables.count(old) == 1
        place, written = "# A value outside a limit fails", tables.replace(old, new) if old else tables
        assert text.count(place) == 1
        path.write_text(text.replace(place, f"{written}\n{place}"), encoding="utf-8")
        return load_rig(path)

    return load


def test_the_tables_make_the_worlds_disturbances(with_tables):
    rig = with_tables(CURRENT + PASSING + CABLE)
    disturbances = build_world(rig).disturbances
    assert disturbances.current.current_a(45.25) == 4.0
    assert (
        disturbances.passing.field_ned_ut(70.0)
        == rig.world.passing.make_disturbance().field_ned_ut(70.0)
        != (0.0, 0.0, 0.0)
    )
    assert disturbances.cable.field_ut(79.0) == (0.0, 0.0, 0.0) != disturbances.cable.field_ut(85.0)
    assert list(rig.world.disturbances) == ["current", "passing", "cable"]


def test_a_rig_without_them_has_none_and_the_same_conditions_as_ever(with_tables):
    rig = with_tables("")
    assert build_world(rig).disturbances is None
    assert conditions_sha256(rig) == conditions_sha256(load_rig(DEFAULT))
    assert len({conditions_sha256(with_tables(item)) for item in ("", CURRENT, PASSING, CABLE)}) == 4


@pytest.mark.parametrize(
    ("table", "old", "new", "key", "words"),
    [
        (CURRENT, "[45.5, 8]", "[44, 8]", "current.waveform", "goes back in time"),
        (CURRENT, "[[45, 0], [45.5, 8], [60, 8], [60.5, 0]]", "[]", "current.waveform", "needs 1 to"),
        (CURRENT, "[45, 0]", "[-1, 0]", "current.waveform", "times from 0"),
        (CURRENT, "[45, 0]", "[45]", "current.waveform", "missing"),
        (CURRENT, "[45, 0]", "[45, nan]", "current.waveform", "finite number"),
        (CURRENT, "[60, 8]", "[60, 1e9]", "current.waveform", "within 100000 A"),
        (CURRENT, "waveform", "repeat_s = 15\nwaveform", "current.repeat_s", "at least the 15.5 s of the waveform"),
        (CURRENT, "[0.9, -0.4, 0.3]", "[900, 0, 0]", "world", "hard_iron_ut with current makes mag3110 read up to"),
        (CURRENT, "field_ut_per_a = [0.9, -0.4, 0.3]", "", "current.field_ut_per_a", "is missing"),
        (CURRENT, "[0.9, -0.4, 0.3]", '"strong"', "current.field_ut_per_a", "array"),
        (PASSING, "[0, 2, 0.5]", "[50, 0.01, 0.02]", "passing.place_m", "leads it past at 0.0224 m"),
        (PASSING, "[1.5, 0, 0]", "[0, 0, 0]", "passing.velocity_mps", "a static source"),
        (PASSING, "[1.5, 0, 0]", "[3e8, 0, 0]", "passing.velocity_mps", "to 1000 m/s"),
        (PASSING, "[300, 0, 100]", "[1e7, 0, 0]", "passing.moment_am2", "within 1e+06"),
        (PASSING, "[300, 0, 100]", "[1e5, 0, 0]", "world", "hard_iron_ut with passing makes mag3110 read"),
        (PASSING, "[0, 2, 0.5]", "[0, 2e9, 0]", "passing.place_m", "within 100000 m"),
        (PASSING, "at_s = 70", "at_s = -1", "passing.at_s", "0 to 1e+06"),
        (CABLE, "[1, 0, 0]", "[0, 0, 0]", "cable.direction", "length"),
        (CABLE, "[90, 0, 0.1, 0.15]", "[90, 5, 0, 0]", "cable.places", "past a part at 0 mm"),
        # Both ends of the move are far off: on its way it goes through the part.
        (CABLE, "[91, 0, 0.1, 0.3]", "[91, 0, -0.1, -0.15]", "cable.places", "lie in the part"),
        (CABLE, "current_a = 10", "current_a = 1e6", "cable.current_a", "within 100000 A"),
        (CABLE, "current_a = 10", "current_a = 5000", "world", "hard_iron_ut with cable makes mag3110 read"),
    ],
)
def test_a_wrong_value_is_named_with_key_file_and_line(with_tables, tmp_path, table, old, new, key, words):
    with pytest.raises(ConfigError) as caught:
        with_tables(table, old, new)
    text, path = str(caught.value), tmp_path / "bench.toml"
    assert f": {'world' if key == 'world' else f'world.{key}'}" in text
    assert words in text
    line = re.match(re.escape(str(path)) + r":(\d+): ", text)
    assert line
    parts = ["[world]"] if key == "world" else [key.split(".")[1], f"[world.{key.split('.')[0]}]"]
    first = path.read_text().splitlines()[int(line[1]) - 1]
    assert any(first.startswith(part) for part in parts)


def test_an_unknown_key_is_named_with_the_nearest_known_one(with_tables):
    with pytest.raises(UnknownKeyError, match=r"bench\.toml:\d+: unknown key 'wave_form'; did you mean 'waveform'"):
        with_tables(CURRENT, "waveform", "wave_form")


def test_a_recording_that_is_played_cannot_be_disturbed(with_tables):
    with pytest.raises(ConfigError, match=r"world\.playback: has its own field: cable, current cannot|current, cable"):
        with_tables(CURRENT + CABLE + '\n[world.playback]\nfile = "walk.csv"\n')


def test_no_field_is_ever_stronger_than_what_the_range_is_checked_with():
    current = CurrentTable((0.9, -0.4, 0.3), ((0.0, -9.0), (1.0, 8.0)))
    passing = PassingTable((200.0, 100.0, 300.0), (-3.0, 0.3, 0.2), (2.0, 0.1, 0.0), 50.0)
    cable = CableTable(10.0, (1.0, 2.0, 0.0), ((0.0, 0.0, 0.3, 0.1), (2.0, 0.0, -0.3, 0.02)))
    # Between two of these 1000 instants the cable moves by 1.2 mm, and the magnet by 4.
    for table, times in (
        (current, np.linspace(0, 1, 1000)),
        (passing, np.linspace(50, 54, 2000)),
        (cable, np.linspace(0, 2, 1000)),
    ):
        world = table.make_disturbance()
        field = world.field_ned_ut if table is passing else world.field_ut
        most = max(math.hypot(*field(float(time_s))) for time_s in times)
        assert 0.3 * table.largest_ut < most <= table.largest_ut


def test_a_disturbance_begins_when_it_first_changes_or_comes_near():
    assert CurrentTable((1.0, 0.0, 0.0), ((3.0, 2.0), (45.0, 2.0), (46.0, 0.0))).begins_s == 45.0
    assert CableTable(1.0, (1.0, 0.0, 0.0), ((3.0, 0.0, 1.0, 1.0),)).begins_s == math.inf
    # Nearest at 70 s, 2 m away, at 1.5 m/s: 4 m before.
    assert PassingTable((1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (1.5, 0.0, 0.0), 70.0).begins_s == pytest.approx(70 - 4 / 1.5)
    assert PassingTable((1.0, 0.0, 0.0), (3.0, 2.0, 0.0), (1.5, 0.0, 0.0), 70.0).begins_s == pytest.approx(68 - 4 / 1.5)
