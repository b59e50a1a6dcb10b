"""Rig files: what the shipped ones say, and what is said about wrong ones."""

import math
import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from hiltest.boards.board import Declared
from hiltest.calibration.dpi import PAIRS_MINIMUM
from hiltest.errors import ConfigError, UnknownKeyError
from hiltest.measurement import Limit
from hiltest.orientation.angles import Pose, wrap_180
from hiltest.rig import build_world, world_truth
from hiltest.rig.cycles import CountedFunctions
from hiltest.rig.rig_file import load_rig
from hiltest.rig.toml_tables import DPI_PAIRS_MINIMUM, CoveredPart, RigValueError, TurntableSettings
from hiltest.world.sensors.fxos8700cq import noise_at_oversampling, oversampling

from ..parts_on_buses import parts_on_buses

RIGS = Path(__file__).parents[2] / "hil" / "rigs"
DEFAULT = RIGS / "virtual-k64f.toml"
WARMING_UP = "temperature_degc = 33.0\ntemperature_end_degc = 41.0\ntemperature_ramp_s = 150.0"


@pytest.fixture
def edited(tmp_path):
    """Return a function that writes the default rig with one text replaced, and loads it."""

    def load(old, new, more_of_the_world=""):
        text = DEFAULT.read_text(encoding="utf-8")
        text = text.replace("[world]", f"[world]\n{more_of_the_world}") if more_of_the_world else text
        assert text.count(old) == 1, f"{old!r} is in the default rig {text.count(old)} times"
        path = tmp_path / "bench.toml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return load_rig(path)

    return load


def test_a_limit_of_the_full_set_must_not_be_met_by_the_gate_set(edited):
    rig = edited("[limits]", '[limits]\n"lamp.life" = { min = 3, unit = "h", suite = "full" }')
    assert rig.limits["lamp.life"] == rig.limits_of("full")["lamp.life"] == Limit(min=3)
    assert "lamp.life" in rig.full_only
    assert rig.limits_of("gate").keys() == rig.limits.keys() - rig.full_only


@pytest.mark.parametrize(
    ("table", "suite", "complaint"),
    [
        ("limits", "nightly", "limits.lamp.life.suite: input should be 'gate' or 'full', not \"nightly\""),
        ("information", "full", "information.lamp.life: suite selects the tests that must meet a limit"),
    ],
)
def test_a_suite_that_means_nothing_is_refused(edited, table, suite, complaint):
    with pytest.raises(ConfigError, match=re.escape(complaint)):
        edited(f"[{table}]", f'[{table}]\n"lamp.life" = {{ min = 3, unit = "h", suite = "{suite}" }}')


def line_of(text, path=DEFAULT):
    return next(n for n, line in enumerate(path.read_text().splitlines(), start=1) if line.startswith(text))


@pytest.mark.parametrize("path", sorted(RIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_rig_loads_under_its_file_name(path):
    assert load_rig(path).name == path.stem


def test_the_default_rig_is_the_bench_of_the_thesis():
    rig = load_rig(DEFAULT)
    assert (rig.field.strength_ut, rig.field.dip_deg) == (48.5, 62.0)
    assert rig.mounting.yaw_deg == 1.7
    assert rig.world.mag3110_noise_ut[0] == 0.4
    assert all(abs(bias) >= 1.0 for bias in rig.world.gyroscope_bias_dps)
    assert max(map(abs, rig.world.accelerometer_offset_mg)) <= 3.0
    assert max(map(abs, rig.world.accelerometer_gain_error_percent)) <= 0.3
    assert rig.limits["heading.direct.max"] == Limit(max=1.8)
    assert rig.limits["heading.direct.bias"] == Limit.within(rig.mounting.uncertainty_deg + 0.5)
    assert not any(name.startswith("heading.uncalibrated") for name in rig.limits)


@pytest.mark.parametrize(
    ("text", "place"), [("schema = 1\nname = one\n", "2"), ('schema = 1\nname = "x', "2")], ids=["value", "end"]
)
def test_a_mistake_in_the_toml_is_named_by_file_and_line(tmp_path, text, place):
    path = tmp_path / "bench.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    assert str(caught.value).startswith(f"{path}:{place}: not TOML: ")


def test_a_rig_without_its_schema_says_what_to_write(edited):
    with pytest.raises(ConfigError, match=r"bench\.toml:1: schema is missing; write `schema = 1` above"):
        edited("schema = 1\n", "")


def test_a_unit_belongs_to_a_name(edited, tmp_path):
    assert edited("[limits]", '[limits]\n"lamp.current" = { max = 3, unit = "mA" }').units["lamp.current"] == "mA"
    text = DEFAULT.read_text(encoding="utf-8")
    text = text.replace("[limits]", '[limits]\n"lamp.current" = { max = 3, unit = "mA" }')
    text = text.replace("[information]", '[information]\n"lamp.current" = { max = 2, unit = "A" }')
    path = tmp_path / "twice.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"information\.lamp\.current: its unit is 'mA' under limits, 'A' here"):
        load_rig(path)


def test_poses_are_twelve_headings_at_five_tilts_level_first():
    procedure = load_rig(DEFAULT).procedure
    poses = procedure.known_angle_poses()
    assert len(poses) == len(set(poses)) == 60
    assert poses[:12] == procedure.known_angle_poses("level") == tuple(Pose(h) for h in procedure.headings_deg)
    assert {(pose.pitch_deg, pose.roll_deg) for pose in poses} == {(0, 0), (20, 0), (0, -20), (20, 25), (-25, -15)}


def test_axes_of_the_magnetometers_chip_are_those_along_the_boards(edited):
    rig = edited("[sensors]", '[sensors]\naxes = ["-y", "x", "z"]')
    assert rig.sensors.chip_to_body == ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert load_rig(DEFAULT).sensors.chip_to_body is None


@pytest.mark.parametrize("path", sorted(RIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_rig_crosses_the_axes_tilts_both_ways_and_turns_in_both_directions(path):
    rig = load_rig(path)
    headings = [heading + rig.mounting.yaw_deg for heading in rig.procedure.headings_deg]
    for axis in (0.0, 90.0, 180.0, 270.0):
        assert min(abs(wrap_180(heading - axis)) for heading in headings) < rig.mounting.uncertainty_deg
    assert sum(pitch * roll != 0.0 for pitch, roll in rig.procedure.tilts_deg) >= 2
    steps = [wrap_180(after - before) for before, after in pairwise(headings)]
    assert min(steps) < -30.0 < 30.0 < max(steps)


def test_the_rotated_rig_is_the_default_one_with_its_soft_iron_turned_by_three_degrees():
    default, rotated = load_rig(DEFAULT), load_rig(RIGS / "virtual-k64f-rotated.toml")
    same = replace(
        rotated,
        name=default.name,
        path=default.path,
        information=default.information,
        units=default.units,
        world=replace(rotated.world, soft_iron=default.world.soft_iron),
    )
    assert same == default
    sine, cosine = math.sin(math.radians(3.0)), math.cos(math.radians(3.0))
    turn = ((cosine, 0.0, sine), (0.0, 1.0, 0.0), (-sine, 0.0, cosine))
    for row in range(3):
        for column in range(3):
            product = sum(turn[row][k] * default.world.soft_iron[k][column] for k in range(3))
            assert rotated.world.soft_iron[row][column] == pytest.approx(product, abs=5.1e-7)  # six digits in the file


def test_the_untrimmed_rig_is_the_default_bench_with_a_part_that_was_never_trimmed():
    default, untrimmed = load_rig(DEFAULT), load_rig(RIGS / "virtual-k64f-untrimmed.toml")
    assert untrimmed.world.accelerometer_offset_mg == (20.0, -20.0, 20.0)
    gains = [untrimmed.world.accelerometer_response[axis][axis] for axis in range(3)]
    assert gains == pytest.approx([1.025, 0.975, 1.025], abs=1e-12)
    for key in ("soft_iron", "hard_iron_ut", "face_errors_deg", "mag3110_noise_ut", "mounting_yaw_deg"):
        assert getattr(untrimmed.world, key) == getattr(default.world, key)
    assert untrimmed.limits["heading.direct-untrimmed.max"] == Limit(min=4.8)


def test_the_true_faces_are_within_what_is_declared():
    for name in ("virtual-k64f", "virtual-k64f-rotated", "virtual-k64f-untrimmed", "virtual-k64f-hand-laid"):
        rig = load_rig(RIGS / f"{name}.toml")
        assert max(math.hypot(*turn) for turn in rig.world.face_errors_deg) <= rig.faces.uncertainty_deg
        # The turn about the vertical would be none of the face's.
        assert all(turn[face // 2] == 0.0 for face, turn in enumerate(rig.world.face_errors_deg))


def test_a_board_laid_down_by_hand_is_askew_by_a_degree_rms():
    default, by_hand = load_rig(DEFAULT), load_rig(RIGS / "virtual-k64f-hand-laid.toml")
    # Of the three angles of a face the one about the vertical is none of it.
    squares = math.fsum(angle * angle for turn in by_hand.world.face_errors_deg for angle in turn)
    assert math.sqrt(squares / 12) == pytest.approx(1.0, abs=0.01)
    for key in ("soft_iron", "hard_iron_ut", "mag3110_noise_ut", "mounting_yaw_deg"):
        assert getattr(by_hand.world, key) == getattr(default.world, key)


def test_six_positions_need_declared_faces(edited):
    with pytest.raises(ConfigError, match=r"faces: is missing: procedure\.accelerometer_calibration"):
        edited("[faces]\nuncertainty_deg = 0.1\n", "")


def test_an_unknown_key_is_named_with_its_line_and_the_nearest_known_one(edited):
    with pytest.raises(UnknownKeyError) as caught:
        edited("dip_deg = 62.0", "dipp_deg = 62.0")
    assert f"bench.toml:{line_of('dip_deg')}: unknown key 'dipp_deg'; did you mean 'dip_deg'?" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "nearest"),
    [
        ("[turntable]", "[turntabel]", "turntable"),
        ("name = ", "nam = ", "name"),
        ("hard_iron_ut = ", "hard_iron = ", "hard_iron_ut"),
        (WARMING_UP, "[world.drift]\nmag3110_gain_percent = [0, 0, 0]", "mag3110_gain_percent_per_degc"),
        ("[information]", "[informations]", "information"),
        ('"heading.direct.rms" = { max = 0.75, unit', '"heading.direct.rms" = { maxi = 0.75, unit', "max"),
        ('"heading.direct.rms"', '"heading.direct.rmss"', "heading.direct.rms"),
        ('"heading.direct.rms"', '"heading.*.max"', "heading.direct.max"),
        ('"heading.iterative.bias"', '"heading.iterative.bais"', "heading.iterative.bias"),
        ("schema = 1", 'schema = 1\npath = "/tmp"', None),
    ],
)
def test_every_table_knows_its_keys(edited, old, new, nearest):
    with pytest.raises(UnknownKeyError) as caught:
        edited(old, new)
    assert caught.value.nearest == nearest


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("strength_ut = 48.5", 'strength_ut = "48.5"', "field.strength_ut", 'valid number, not "48.5"'),
        ("strength_ut = 48.5", "strength_ut = 48500", "field.strength_ut", "48500 nT are 48.5 uT"),
        ("strength_ut = 48.5", "strength_ut = -1", "field.strength_ut", "must be above 0"),
        ('kind = "simulated"', 'kind = "simulated"\ntumble_s = 0.0', "turntable.tumble_s", "must be above 0"),
        ("strength_ut = 48.5", "strength_ut = nan", "field.strength_ut", "finite number"),
        ("dip_deg = 62.0", "dip_deg = 90", "field.dip_deg", "headings are undefined"),
        ("strength_ut = 48.5", "", "field.strength_ut", "is missing"),
        ("schema = 1", "schema = 2", "schema", "should be 1"),
        ("readings_per_pose = 16", "readings_per_pose = 16.5", "procedure.readings_per_pose", "valid integer"),
        ("tumble_points = 300", "tumble_points = 513", "procedure.tumble_points", "512"),
        ("tumble_points = 300", "tumble_points = 299", "procedure.tumble_points", 'or dpi = "none" beside it'),
        ("[[0, 0], [20, 0],", "[[1, 0], [20, 0],", "procedure.tilts_deg", "level"),
        ("hard_iron_ut = [2.4, -2.2, 4.0]", "hard_iron_ut = [2.4, -2.2]", "world.hard_iron_ut", "missing"),
        ('kind = "simulated"', 'kind = "robot"', "turntable.kind", "'simulated', 'operator' or 'grbl'"),
        ('kind = "simulated"', 'kind = "operator"', "turntable", "requires a board"),
        ('kind = "virtual"', 'kind = "real"', "world", "not allowed for others"),
        (WARMING_UP, "temperature_end_degc = 40.0", "world.temperature_end_degc", "requires temperature_ramp_s"),
        (WARMING_UP, "temperature_ramp_s = 9.0", "world.temperature_end_degc", "requires"),
        (
            WARMING_UP,
            "temperature_end_degc = 40.0\ntemperature_ramp_s = 9.0\ntemperature_time_constant_s = 3.0",
            "world.temperature_ramp_s",
            "excludes temperature_time_constant_s",
        ),
        (
            WARMING_UP,
            "temperature_end_degc = 40.0\ntemperature_time_constant_s = 0.0",
            "world.temperature_time_constant_s",
            "must be above 0",
        ),
        ("[faces]\nuncertainty_deg = 0.1", "[faces]\nuncertainty_deg = 0", "faces.uncertainty_deg", "must be above 0"),
        ('"six-position"', '"twelve-position"', "procedure.accelerometer_calibration", "'none' or 'six-position'"),
        ("[ 0.00,  0.08, -0.05]", "[ 0.01,  0.08, -0.05]", "world.accelerometer_cross_axis_percent", "diagonal"),
        ("  [ 0.05,  0.00,  0.06],\n", "", "world.face_errors_deg", "each of the six faces"),
        (
            'accelerometer_calibration = "six-position"',
            'untrimmed_calibrations = ["direct"]',
            "procedure.untrimmed_calibrations",
            "requires an accelerometer_calibration",
        ),
        (WARMING_UP, 'fitted = ["mpu6050"]', "world.fitted", "known parts: mag3110"),
        ("[ 1.022,  0.010, -0.006]", "[-1.022, -0.010, 0.006]", "world.soft_iron", "write mirrored = true"),
        ("[ 1.022,  0.010, -0.006]", "[ 0.010,  0.982,  0.009]", "world.soft_iron", "is singular"),
        ("[ 1.022,  0.010, -0.006]", "[ 0.0, 0.0, 0.0]", "world.soft_iron", "is singular"),
        ("[sensors]", '[sensors]\naxes = ["y", "-y", "z"]', "sensors.axes", "x, y and z in some order"),
        ("[358.3, 58.3,", "[358.3, 358.3,", "procedure.headings_deg", "repeats a value"),
        ("[[0, 0], [20, 0],", "[[0, 0], [0, 0],", "procedure.tilts_deg", "repeats a value"),
        ("magnetometer_noise_ut = 0.4", "magnetometer_noise_ut = 0.1", "sensors", "and the world has 0.4"),
        (
            "magnetometer_noise_ut = 0.4",
            'accepted_settings = ["CTRL_REG0 0x04"]\nmagnetometer_noise_ut = 0.4',
            "sensors.accepted_settings",
            "such as 'FXAS21002C CTRL_REG0 0x04'",
        ),
        ("magnetometer_noise_ut = 0.4", "magnetometer_noise_ut = 0.9", "sensors", "ratio is 2"),
        (
            '"heading.direct.max" = { max = 1.8',
            '"heading.direct.max" = { max = 180',
            "limits.heading.direct.max",
            "exceeds 180 degrees",
        ),
        (
            "[limits]",
            '[tolerances]\n"heading.direct.max" = { absolute = 1.8, unit = "deg" }\n\n[limits]',
            "tolerances.heading.direct.max",
            "is wider than its limit",
        ),
        (
            "[limits]",
            '[tolerances]\n"heading.direct.bias" = { absolute = 1.4, unit = "deg" }\n\n[limits]',
            "tolerances.heading.direct.bias",
            "within ±0.7",
        ),
        (
            "[limits]",
            '[tolerances]\n"cycles.direct.total" = { absolute = 0, relative = 1.0, unit = "cycle" }\n[limits]',
            "tolerances.cycles.direct.total",
            "at most 12 000",
        ),
        ("[limits]", "[cycles]\nfit = 3\n[limits]", "cycles.fit", "not 3"),
        ("[limits]", "[cycles]\nfit = { functions = [] }\n[limits]", "cycles.fit.functions", "name one at least"),
        ("[limits]", '[cycles]\nfit = { functions = ["a", "b"] }\n[limits]', "cycles.fit.ends", "word in memory"),
        (
            "[limits]",
            '[cycles]\nfit = { functions = ["a"], ends = "n", ends_when = "done" }\n[limits]',
            "cycles.fit.ends_when",
            "'zero' or 'changed'",
        ),
    ],
)
def test_a_wrong_value_is_named_with_key_file_and_line(edited, old, new, key, words):
    with pytest.raises(ConfigError) as caught:
        edited(old, new)
    assert f": {key}" in str(caught.value)
    assert words in str(caught.value)
    assert "bench.toml" in str(caught.value)


def test_a_function_to_count_is_named_alone_or_with_the_word_that_ends_its_solutions(edited):
    written = 'direct = "fit"\nslices = { functions = ["a", "b"], ends = "state+0x10", ends_bytes = 1 }\n'
    rig = edited("[limits]", f"[cycles]\n{written}[limits]")
    assert rig.cycles["direct"] == CountedFunctions(("fit",))
    assert rig.cycles["slices"] == CountedFunctions(("a", "b"), "state+0x10", "zero", 1)
    assert Declared.select(rig).functions == {"direct": "fit"}
    with pytest.raises(UnknownKeyError, match="ends_when"):
        edited("[limits]", '[cycles]\nfit = { functions = ["a"], end_when = "zero" }\n[limits]')


def test_a_mirroring_soft_iron_that_is_meant_and_a_world_without_noise_are_taken(edited):
    meant = edited("[ 1.022,  0.010, -0.006]", "[-1.022, -0.010, 0.006]", "mirrored = true")
    assert meant.world.mirrored
    assert edited("mag3110_noise_ut = [0.4, 0.35, 0.3, 0.25]", "mag3110_noise_ut = [0.0, 0.0, 0.0, 0.0]").world


def test_a_tumble_too_short_for_the_calibration_against_gravity_goes_without_it(edited):
    assert DPI_PAIRS_MINIMUM == PAIRS_MINIMUM
    rig = edited("tumble_points = 300", 'tumble_points = 299\ndpi = "none"')
    assert (rig.procedure.tumble_points, rig.procedure.dpi) == (299, "none")


def test_a_limit_in_another_unit_is_refused(edited):
    with pytest.raises(ConfigError, match=r"limits\.gyroscope\.bias_error: its unit is 'dps', not 'deg'"):
        edited('0.1, unit = "dps"', '0.1, unit = "deg"')


def test_a_limit_without_bounds_is_refused(edited):
    with pytest.raises(ConfigError, match="needs min, max or both"):
        edited("{ max = 0.75, unit", "{ unit")


def test_a_limit_for_a_measurement_of_ones_own_is_kept(edited):
    rig = edited('"gyroscope.bias_error" =', '"bench.noise" = { max = 3, unit = "uT" }\n"gyroscope.bias_error" =')
    assert rig.limits["bench.noise"] == Limit(max=3.0)


def test_a_limit_tighter_than_the_reference_is_refused_with_both_numbers(edited):
    with pytest.raises(ConfigError) as caught:
        edited('"heading.direct.max" = { max = 1.8', '"heading.direct.max" = { max = 0.2')
    # Turntable 0.1 and mounting 0.2: sqrt(0.05) = 0.224.
    assert "limits.heading.direct.max of 0.2 deg" in str(caught.value)
    assert "0.224 deg" in str(caught.value)


def test_the_mountings_uncertainty_does_not_bound_a_centred_limit(edited):
    rig = edited('"heading.direct.max_centred" = { max = 1.8', '"heading.direct.max_centred" = { max = 0.15')
    assert rig.limits["heading.direct.max_centred"] == Limit(max=0.15)
    assert rig.reference_uncertainty_deg("heading.direct.max_centred") == pytest.approx(0.1)
    assert rig.reference_uncertainty_deg("heading.direct.bias") == pytest.approx(math.sqrt(0.05))
    assert rig.reference_uncertainty_deg("cycles.direct.total") is None
    with pytest.raises(ConfigError, match="tighter"):
        edited('"heading.direct.max_centred" = { max = 1.8', '"heading.direct.max_centred" = { max = 0.05')


@pytest.mark.parametrize(
    "name", ["cycles.fn", "compass.lag", "heading.direct.maximum", "cycles.mine.total", "heading.mine.tilt_sensitivity"]
)
def test_a_limit_on_any_name_is_taken_with_its_unit(edited, name):
    unit = "deg" if name.startswith("heading") else "cycle"
    rig = edited('"heading.direct.rms" = ', f'"{name}" = {{ max = 7, unit = "{unit}" }}\n"heading.direct.rms" = ')
    assert rig.limits[name] == Limit(max=7)
    assert rig.units[name] == unit


def test_the_unit_of_a_known_kind_is_its_own(edited):
    with pytest.raises(ConfigError, match="its unit is 'deg', not 'mrad'"):
        edited('max = 0.75, unit = "deg"', 'max = 0.75, unit = "mrad"')


@pytest.mark.parametrize(
    ("kind", "reference", "unknown", "hint"),
    [
        ("magnetometer", "MAG3110", "MAG3111", "did you mean 'MAG3110'?"),
        ("magnetometer", "MAG3110", "FXAS21002C", "known: MAG3110, FXOS8700CQ magnetometer, on-board"),
        ("accelerometer", "FXOS8700CQ accelerometer", "FXOS8700CQ acceleromter", "mean 'FXOS8700CQ accelerometer'?"),
        ("gyroscope", "FXAS21002C", "", "known: FXAS21002C"),
    ],
)
def test_a_sensor_that_no_simulated_world_has_is_refused_with_its_line(edited, kind, reference, unknown, hint):
    with pytest.raises(ConfigError, match=rf"\.toml:[1-9][0-9]*: sensors\.{kind}: no {kind} '{unknown}'; ") as caught:
        edited(f'{kind} = "{reference}"', f'{kind} = "{unknown}"')
    assert hint in str(caught.value)


@pytest.mark.parametrize("text", [b"name = ", b"\xff\xfe", b"[field\n"])
def test_a_file_that_is_not_toml_is_named(tmp_path, text):
    path = tmp_path / "bench.toml"
    path.write_bytes(text)
    with pytest.raises(ConfigError, match=r"bench\.toml"):
        load_rig(path)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere\.toml: No such file or directory; name a rig"):
        load_rig(tmp_path / "nowhere.toml")


def test_truth_is_in_counts_and_a_real_bench_has_none():
    truth = world_truth(load_rig(DEFAULT))
    assert truth.hard_iron_counts == (24.0, -22.0, 40.0)
    assert truth.mounting_yaw_deg == 1.7
    assert world_truth(load_rig(RIGS / "frdm-k64f.toml")) is None
    with pytest.raises(ValueError, match="no simulated world"):
        build_world(load_rig(RIGS / "frdm-k64f.toml"))


def test_the_true_mounting_may_differ_from_the_declared_one(edited):
    rig = edited("[mounting]\nyaw_deg = 1.7 ", "[mounting]\nyaw_deg = 0.0 ")
    believed = replace(rig, world=replace(rig.world, mounting_yaw_deg=None))
    assert build_world(rig).state_at(0.0).pose.heading_deg == 1.7
    assert build_world(believed).state_at(0.0).pose.heading_deg == 0.0
    assert world_truth(rig).mounting_yaw_deg == 1.7


def test_the_shield_is_on_bus_1_and_parts_can_be_left_off():
    rig = load_rig(DEFAULT)
    buses = parts_on_buses(rig, build_world(rig), 1)
    assert {bus: [part.address for part in parts] for bus, parts in buses.items()} == {
        "i2c0": [0x1D],
        "i2c1": [0x0E, 0x1E, 0x20],
    }
    bare = replace(rig, world=replace(rig.world, fitted=("onboard-fxos8700cq",)))
    buses = parts_on_buses(bare, build_world(bare), 1)
    assert {bus: [part.address for part in parts] for bus, parts in buses.items()} == {"i2c0": [0x1D], "i2c1": []}


def test_importing_the_rig_imports_neither_numpy_nor_pydantic():
    code = "import sys, hiltest.rig; print(sorted({'numpy', 'pydantic', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_a_bench_may_leave_its_mounting_undeclared(edited):
    text = DEFAULT.read_text(encoding="utf-8")
    table = text[text.index("[mounting]") : text.index("[turntable]")]
    rig = edited(table, "")
    assert rig.mounting is None
    assert build_world(rig).state_at(0.0).pose.heading_deg == 1.7  # the board stays as it sits
    # Nothing is known of the mounting, so the table alone bounds what a limit may ask.
    assert rig.reference_uncertainty_deg("heading.direct.max") == pytest.approx(0.1)
    straight = replace(rig, world=replace(rig.world, mounting_yaw_deg=None))
    assert build_world(straight).state_at(0.0).pose.heading_deg == 0.0


HARSH = RIGS / "virtual-k64f-harsh.toml"


def test_the_harsh_rig_is_the_bench_that_the_limits_were_simulated_for():
    rig = load_rig(HARSH)
    assert math.hypot(*rig.world.hard_iron_ut) == pytest.approx(5.0 * rig.field.strength_ut, abs=0.5)
    assert rig.procedure.readings_per_pose == 64
    assert (rig.procedure.calibration_points, rig.procedure.further_calibrations) == (300, ("direct@100",))
    assert rig.limits["heading.direct.max"] == Limit(max=2.3)
    assert rig.limits["heading.direct@100.max"] == Limit(max=3.1)
    assert rig.limits["heading.uncalibrated.max"] == Limit(min=90.0)
    assert rig.limits["heading.direct.float32_error"] == Limit(max=0.01)
    # The firmware sets the part to 200 Hz and oversampling code 7: 8 samples to an output.
    assert oversampling(200.0, 7) == 8
    assert noise_at_oversampling(8, rig.world.fxos8700cq_noise_ut) == pytest.approx(1.0, abs=1e-6)
    assert rig.sensors.magnetometer_noise_ut == 1.0


@pytest.mark.parametrize(("name", "inside"), [("harsh", 60), ("harsh-cap", 60), ("harsh-outside", 0)])
def test_the_judged_poses_of_the_harsh_rigs_lie_all_inside_what_is_covered_or_all_outside(name, inside):
    rig = load_rig(RIGS / f"virtual-k64f-{name}.toml")
    covered, world = rig.turntable.covered, build_world(rig)
    observed = 0
    for pose in rig.procedure.known_angle_poses():
        field = world.state_at(world.turn_to(pose, time_s=0.0)).field_body_ut
        along = sum(a * b for a, b in zip(covered.axis, field, strict=True)) / math.hypot(*field)
        observed += along / math.hypot(*covered.axis) > 1.0 - 2.0 * covered.fraction
    assert observed == inside


def test_the_variants_of_the_harsh_rig_differ_in_what_is_covered_and_what_is_judged():
    harsh, outside, cap = (load_rig(RIGS / f"virtual-k64f-harsh{name}.toml") for name in ("", "-outside", "-cap"))
    covered = {"outside": CoveredPart((0.0, 0.0, -1.0), 0.5), "cap": CoveredPart((0.0, 0.0, 1.0), 0.2)}

    def like(variant, part):
        return (
            replace(
                variant,
                name=harsh.name,
                path=harsh.path,
                turntable=replace(variant.turntable, covered=harsh.turntable.covered),
            )
            if variant.turntable.covered == part
            else None
        )

    assert like(cap, covered["cap"]) == harsh
    unjudged = like(outside, covered["outside"])
    assert replace(unjudged, limits=harsh.limits, information=harsh.information) == harsh
    assert outside.limits | outside.information == harsh.limits | harsh.information
    assert {name for name in outside.limits if name.startswith("heading.")} == {
        "heading.direct.float32_error",
        "heading.direct@100.float32_error",
        "heading.corrected.float32_error",
        "heading.uncalibrated.max",
        "heading.uncalibrated.max_level",
    }


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("fraction = 0.5", "fraction = 0", "turntable.covered.fraction", "above 0"),
        ("fraction = 0.5", "fraction = 1.5", "turntable.covered.fraction", "at most 1"),
        ("axis = [0, 0, 1]", "axis = [0, 0, 0]", "turntable.covered.axis", "direction"),
        ("axis = [0, 0, 1]", "axes = [0, 0, 1]", "", "unknown key 'axes'; did you mean 'axis'?"),
        ('["direct@100"]', '["direct"]', "procedure.further_calibrations", "such as direct@100"),
        ('["direct@100"]', '["direct@8"]', "procedure.further_calibrations", "names 'direct@8'"),
        ('["direct@100"]', '["direct@301"]', "procedure.further_calibrations", "9 to tumble_points"),
        ("[170.0, -121.0, 124.0]", "[1170.0, 0, 0]", "world", "fxos8700cq read up to 1220 uT; its axes stop at 1200"),
        ("[2.236068, 0.447214]", "[2.2, -0.4]", "world.fxos8700cq_noise_ut", "negative"),
    ],
)
def test_a_wrong_value_of_the_harsh_rig_is_named(tmp_path, old, new, key, words):
    text = HARSH.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path = tmp_path / "bench.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    assert f": {key}" in str(caught.value)
    assert words in str(caught.value)


def test_only_a_simulated_tumble_can_be_confined():
    with pytest.raises(RigValueError, match="simulated"):
        TurntableSettings("operator", 0.5, covered=CoveredPart((0.0, 0.0, 1.0), 0.5))


def test_the_truth_is_that_of_the_magnetometer_that_is_judged():
    default = load_rig(DEFAULT)
    assert default.magnetometer_part == "mag3110"
    other = replace(default, sensors=replace(default.sensors, magnetometer="FXOS8700CQ magnetometer"))
    # Its zero-flux offset, 9, -14 and 6 uT, on top of the hard iron.
    assert world_truth(other).hard_iron_counts == pytest.approx((114.0, -162.0, 100.0))
    first = replace(default, sensors=replace(default.sensors, magnetometer=None))
    assert first.magnetometer_part == "mag3110"


def test_an_arithmetic_limit_is_not_held_against_the_turntable():
    rig = load_rig(HARSH)
    assert rig.reference_uncertainty_deg("heading.direct@100.float32_error") is None
    assert rig.reference_uncertainty_deg("heading.direct@100.max") == pytest.approx(math.sqrt(0.05))
