"""The rig of a compass that prints lines: a mistake in its table is refused with file, line, key and the next step."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.interfaces.kinds import open_interfaces
from hiltest.interfaces.quantities import Moment, Quantity, StreamInterface
from hiltest.rig.rig_file import load_rig

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "text-compass.toml"
GROUP, FIELD = "(?P<roll>", "\n[field]"


def opened(folder: Path, old: str = "", new: str = "") -> StreamInterface:
    text = RIG.read_text(encoding="utf-8")
    assert not old or text.count(old) == 1
    (folder / "mine.toml").write_text(text.replace(old, new) if old else text, encoding="utf-8")
    interface = open_interfaces(load_rig(folder / "mine.toml"))["text"]
    assert isinstance(interface, StreamInterface)
    return interface


def test_it_offers_what_the_sample_compass_prints(tmp_path: Path) -> None:
    assert {offer.key for offer in opened(tmp_path).offers} == {
        "heading",
        "pitch",
        "roll",
        "calibrated",
        "magnetometer",
        "magnetometer_calibrated",
        "accelerometer",
        "hard_iron",
        "inverse_soft_iron",
        "field_strength",
        "fit_error",
    }


def test_values_and_commands_stand_in_tables_of_their_own(tmp_path: Path) -> None:
    more = (
        '\n[device.text.values]\nroll = { unit = "rad" }\n'
        '[device.text.commands]\npose = "p\\r\\n"\nafter_tumble = "\\u0003"\n\n[field]'
    )
    interface = opened(tmp_path, "\n[field]", more)
    interface.feed(b"\n.\n", 0.0)
    (observed,) = interface.feed(b"HDG=1 PIT=0 ROL=1\n", 0.0)
    assert observed.values[Quantity.ROLL] == pytest.approx(57.29578)
    assert (interface.commands(Moment.POSE), interface.commands(Moment.AFTER_TUMBLE)) == (b"p\r\n", b"\x03")


@pytest.mark.parametrize(
    ("old", "new", "at", "words"),
    [
        (GROUP, "(?P<rol>", "patterns", "device.text.patterns: 'HDG="),
        (GROUP, "(?P<rol>", "patterns", "has the group 'rol', which is not a quantity; did you mean 'roll'?"),
        (GROUP, "(?P<roll>(", "patterns", r"ROL=(?P<roll>(\S+)' is not a regular expression: missing )"),
        ("^ERROR", "[ERROR", "error", "device.text.error: "),
        ("\nerror = ", "\nerrors = ", "errors", "unknown key 'errors'; did you mean 'error'?"),
        ("\nerror", '\nformat = "xml"\nerror', "format", "format: input should be 'lines', 'json' or 'csv'"),
        (
            FIELD,
            f"[device.text.values]\nrol = {{}}{FIELD}",
            "rol",
            "values.rol: is not a quantity; did you mean 'roll'?",
        ),
        (FIELD, f'[device.text.values]\nroll = {{unit="T"}}{FIELD}', "roll", "values.roll.unit: 'T' is not a unit"),
        (FIELD, f"[device.text.values]\nroll = {{unit='count'}}{FIELD}", "roll", "'count' needs a scale"),
        (FIELD, f"[device.text.commands]\npoze = ''{FIELD}", "poze", "'poze'; did you mean 'pose'?"),
        ('kind = "text"', 'kind = "fsflk"', 'kind = "fsflk"', 'device.kind: must be "text", or have it in a list'),
        ("[device.text]", "[device.fsflk]", "patterns", "unknown key 'patterns'"),
    ],
)
def test_a_mistake_is_refused_with_its_line(tmp_path: Path, old: str, new: str, at: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        opened(tmp_path, old, new)
    rig = tmp_path / "mine.toml"
    line = next(n for n, text in enumerate(rig.read_text(encoding="utf-8").splitlines(), 1) if text.startswith(at))
    assert str(caught.value).startswith(f"{rig}:{line}: ")
    assert words in str(caught.value)
