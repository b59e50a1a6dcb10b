"""All models of the table of parts: their registers, whatever firmware writes into them."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.errors import ConfigError
from hiltest.measurement.sensor_registers import registers_of
from hiltest.rig.parts import MODELS, load_model
from hiltest.world.sensors import TableSensor, read_table

from .bus_master import write
from .driver_bus import setup

MOST_LINES = 150  # of a model: its figures are in the table


def every_model() -> Iterator[type[TableSensor]]:
    for name in MODELS:
        model = load_model(name)
        yield from (model, *model.companion_models)


EVERY_MODEL = list(every_model())


@pytest.mark.parametrize("model", EVERY_MODEL)
def test_a_model_is_short(model: type[TableSensor]) -> None:
    assert len(Path(inspect.getfile(model)).read_text().splitlines()) <= MOST_LINES


@pytest.mark.parametrize("model", EVERY_MODEL)
def test_the_registers_that_firmware_writes_have_names(model: type[TableSensor]) -> None:
    rows = registers_of(model.table.part)
    without = {hex(address) for address in model(setup()).settings().keys() - rows.keys()}
    only_commands = {
        hex(address)
        for address, mask in model.table.writable.items()
        if mask and not any(field.address == address for field in model.table.fields.values())
    }
    assert without <= only_commands


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(EVERY_MODEL),
    st.lists(st.tuples(st.integers(0, 255), st.integers(0, 255), st.floats(1e-4, 0.3)), max_size=12),
)
def test_a_model_survives_whatever_is_written(model: type[TableSensor], accesses: list[tuple[int, int, float]]) -> None:
    part, now_s = model(setup()), 0.5
    registers = sorted(model.table.names)
    for index, value, pause_s in accesses:
        write(part, now_s, registers[index % len(registers)] & 0xFF, value)
        now_s += pause_s
        if not part.start(True, now_s):
            continue
        state = part.state()
        first = [part.read(now_s) for _ in range(40)]
        part.restore(state)
        assert [part.read(now_s) for _ in range(40)] == first
        assert all(0 <= byte <= 0xFF for byte in first)
        part.stop(now_s)
        for output in part.outputs:
            assert output.weight > 0.0
            assert all(abs(word) <= output._full_scale + 1 for word in output.counts(output.latest(now_s)))


@pytest.mark.parametrize("model", [model for model in EVERY_MODEL if any(model.table.resetting.values())])
def test_a_reset_by_software_restores_every_setting(model: type[TableSensor]) -> None:
    part = model(setup())
    (address, bit), *_ = ((address, bit) for address, bit in model.table.resetting.items() if bit)
    write(part, 0.4, address & 0xFF, bit)
    before = part.settings()
    for register in part.settings():
        if register != address:
            write(part, 0.5, register & 0xFF, 0x55 & ~model.table.resetting.get(register, 0))
    assert part.settings() != before
    write(part, 0.6, address & 0xFF, bit)
    assert part.settings() == before


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ("", "No such file"),
        ("part = 'X'", "registers"),
        (
            "part = 'X'\naddresses = [1]\n[registers]\nA = { address = 1 }\nB = { address = 1 }",
            "B has the address of A",
        ),
        (
            "part = 'X'\naddresses = [1]\n[registers]\nA = { address = 1, rate = 3 }\nB = { address = 2, rate = 4 }",
            "'rate' of B is also the meaning of other bits",
        ),
        ("part = 'X'\naddresses = [1]\nbots_s = 1\n[registers]\nA = { address = 1 }", "bots_s"),
        (
            "part = 'X'\naddresses = [1]\n[outputs.magnetometer]\nregister = 'OUT'\n[registers]\nA = { address = 1 }",
            "OUT",
        ),
    ],
)
def test_a_wrong_table_is_refused_with_its_reason(tmp_path: Path, table: str, reason: str) -> None:
    if table:
        (tmp_path / "mine.toml").write_text(table)
    with pytest.raises(ConfigError, match=rf"mine\.toml: no register table: .*{reason}"):
        read_table(str(tmp_path / "mine.py"))
