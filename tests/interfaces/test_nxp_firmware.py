"""NXP's Sensor Fusion 7.20, as NXP's sources build it, on the virtual board: its packets and its commands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import hiltest.boards  # noqa: F401  knows hil://
from hiltest.interfaces.packet_stream import PacketBatch, PacketDecoder, heard
from hiltest.interfaces.packets import Algorithm, DebugPacket, MainPacket, Shield
from hiltest.interfaces.toolbox_commands import ToolboxCommand
from hiltest.link.ports import SerialPort, open_port

from ..foreign_elf import foreign_elf

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def port() -> Iterator[SerialPort]:
    """The firmware's line, from power-on."""
    opened = open_port(f"hil://?firmware={foreign_elf('nxp_sensor_fusion.elf')}")
    yield opened
    opened.close()


def listened(port: SerialPort, seconds: float) -> list[PacketBatch]:
    return list(heard(port, PacketDecoder(), seconds=seconds, ended=lambda: False))


def test_its_packets_show_a_board_at_rest_and_stop_on_command(port: SerialPort) -> None:
    batches = listened(port, 0.4)
    assert {table.kind.type for batch in batches for table in batch.tables} >= {1, 2, 3, 4, 6, 7}
    packets = [packet for batch in batches for packet in batch.packets()]
    assert [packet.number for packet in packets] == [
        n % 256 for n in range(packets[0].number, packets[0].number + len(packets))
    ]
    assert {packet.firmware_release for packet in packets if isinstance(packet, DebugPacket)} == {7.2}
    last = [packet for packet in packets if isinstance(packet, MainPacket)][-1]
    assert (last.algorithm, last.board_number, last.shield) == (Algorithm.NINE_AXES, 5, Shield.AGM01)
    # The rig's accelerometer errs by 3 mg, 0.3 % and noise; the firmware cuts off each component at 1/30000.
    assert np.linalg.norm(last.acceleration_g) == pytest.approx(1.0, abs=0.01)
    assert np.linalg.norm(last.rotation) == pytest.approx(1.0, abs=4 / 30_000)

    port.write(ToolboxCommand.DEBUG_PACKETS_OFF.value)
    listened(port, 0.1)  # the command takes its time
    after = {type(packet) for batch in listened(port, 0.2) for packet in batch.packets()}
    assert MainPacket in after
    assert DebugPacket not in after
