"""What the numbers of a rig rest on: two rigs with the same digest can be compared, and no others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.measurement import Tolerance
from hiltest.rig.rig import conditions_sha256
from hiltest.rig.rig_file import load_rig

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
Edit = Callable[..., Path]


@pytest.fixture
def edited(tmp_path: Path) -> Edit:
    """Return a function that writes the default rig with texts replaced."""

    def edit(*changes: tuple[str, str], more: str = "") -> Path:
        text = RIG.read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        file = tmp_path / "edited.toml"
        file.write_text(text + more, encoding="utf-8")
        return file

    return edit


def digest(path: Path) -> str:
    return conditions_sha256(load_rig(path))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("dip_deg = 62.0 ", "dip_deg = 62.1 "),
        ("strength_ut = 48.5", "strength_ut = 48.6"),
        ("yaw_deg = 1.7                             # board", "yaw_deg = 1.8 # board"),
        ("calibration_points = 100 ", "calibration_points = 99 "),
        ("hard_iron_ut = [2.4,", "hard_iron_ut = [2.5,"),
        ('gyroscope = "FXAS21002C"', ""),
        ("readings_per_pose = 16", "readings_per_pose = 17"),
        ("temperature_degc = 33.0", "temperature_degc = 30.0"),
    ],
)
def test_what_numbers_rest_on_changes_the_digest(edited: Edit, old: str, new: str) -> None:
    assert digest(edited((old, new))) != digest(RIG)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"heading.direct.max" = { max = 1.8,', '"heading.direct.max" = { max = 1.5,'),
        ('name = "virtual-k64f"', 'name = "b"'),
        ("seed = 1 ", "seed = 2 "),
        ('poses = "all"', 'poses = "level"'),
        ("# The default bench", "# My bench"),
        ("[sensors]", '[sensors]\naccepted_settings = ["FXAS21002C CTRL_REG0 0x04"]'),
        ('"cycles.direct.fixed" = { max = 2_600, unit = "cycle" }', ""),
        ("strength_ut = 48.5", "strength_ut = 48.50"),
    ],
)
def test_limits_names_comments_seed_and_poses_do_not(edited: Edit, old: str, new: str) -> None:
    assert digest(edited((old, new))) == digest(RIG)


TOLERANCES = """
[tolerances]
"heading.direct.max" = { absolute = 0.05, relative = 0.02, unit = "deg" }
"heading.direct.tilt_sensitivity" = { absolute = 0.2, unit = "deg" }
"compass.lag" = { absolute = 3, unit = "ms" }
"""


def test_a_place_changes_no_digest_and_is_whole(edited: Edit) -> None:
    field, latitude, longitude = "declination_deg = 3.5", "latitude_deg = 46.0", "longitude_deg = 8.9"
    assert digest(edited((field, f"{latitude}\n{longitude}\n{field}"))) == digest(RIG)
    with pytest.raises(ConfigError, match="longitude_deg"):
        load_rig(edited((field, f"{latitude}\n{field}")))


def test_tolerances_are_read_and_change_no_digest(edited: Edit) -> None:
    path = edited(more=TOLERANCES)
    assert load_rig(path).tolerances == {
        "heading.direct.max": Tolerance(0.05, 0.02),
        "heading.direct.tilt_sensitivity": Tolerance(0.2, 0.0),
        "compass.lag": Tolerance(3.0, 0.0),
    }
    assert digest(path) == digest(RIG)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ('"heading.direct.maks" = { absolute = 0.05, unit = "deg" }', "heading.direct.max"),
        ('"heading.direct.max" = { absolute = 0.05, unit = "mdeg" }', "its unit is 'deg'"),
        ('"heading.direct.max" = { absolute = -0.05, unit = "deg" }', "tolerances.heading.direct.max: absolute"),
        ('"heading.direct.max" = { absolute = inf, unit = "deg" }', "absolute"),
        ('"heading.direct.max" = { relative = 0.05, unit = "deg" }', "absolute is missing"),
        ('"heading.direct.max" = { absolute = 0.05, relativ = 0.1, unit = "deg" }', "relative"),
    ],
)
def test_a_wrong_tolerance_is_refused_with_its_line(edited: Edit, line: str, reason: str) -> None:
    path = edited(more=f"\n[tolerances]\n{line}\n")
    number = path.read_text(encoding="utf-8").splitlines().index(line) + 1
    with pytest.raises(ConfigError) as refused:
        load_rig(path)
    assert reason in str(refused.value)
    assert f"{path}:{number}" in str(refused.value)
