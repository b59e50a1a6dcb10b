"""The page about firmware that reports by itself: its table is a rig's, its kind of one's own works."""

from __future__ import annotations

import re
import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from types import ModuleType

import pytest

from hiltest.interfaces import kinds
from hiltest.interfaces.frames import FRAMES
from hiltest.interfaces.kinds import open_interfaces, sources_of
from hiltest.interfaces.quantities import Quantity, StreamInterface
from hiltest.rig.rig_file import load_rig

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "compass.md").read_text(encoding="utf-8")
TABLE = re.findall(r"^```toml\n(\[device\]\n.*?)^```", PAGE, re.M | re.S)[0]
(CODE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
RIG = (ROOT / "hil" / "rigs" / "nxp-fusion-agm01.toml").read_text(encoding="utf-8")


def rig_with(folder: Path, device: str) -> Path:
    file = folder / "mine.toml"
    file.write_text(re.sub(r"^\[device\]\n.*?(?=^\[field\])", device + "\n", RIG, flags=re.M | re.S), encoding="utf-8")
    return file


def test_the_table_of_the_page_is_a_rigs(tmp_path: Path) -> None:
    device = load_rig(rig_with(tmp_path, TABLE)).device
    assert device is not None
    assert (device.kinds, device.tumbles, device.converge_s) == (("fsflk",), 2, 60.0)


def test_every_frame_is_on_the_page_with_its_own_way() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| x .*\| (\w+) \|$", PAGE, re.M))
    assert rows == {name: "clockwise" if frame.clockwise else "counterclockwise" for name, frame in FRAMES.items()}


def test_a_kind_of_ones_own_is_found_by_its_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("mycompass")
    exec(CODE, vars(module))
    monkeypatch.setitem(sys.modules, "mycompass", module)
    own = EntryPoints([EntryPoint("nmea", "mycompass:open_interface", kinds.GROUP)])
    monkeypatch.setattr(kinds, "entry_points", lambda group: own.select(group=group))
    rig = load_rig(rig_with(tmp_path, '[device]\nkind = "nmea"'))
    interfaces = open_interfaces(rig)
    assert sources_of(rig, interfaces) == {Quantity.HEADING: "nmea"}
    (nmea,) = interfaces.values()
    assert isinstance(nmea, StreamInterface)
    assert nmea.feed(b"$HCHDM,12", 0.0) == []
    (answer,) = nmea.feed(b"3.4,M\r\n$HCXDR\n$HCHDM,,M\n", 1.0)
    assert answer.values[Quantity.HEADING].tolist() == [123.4]
    assert nmea.not_understood == 2
