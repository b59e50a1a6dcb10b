"""What firmware of the shield's own interrupts and FIFOs must have read: every sample, polled without firmware."""

from __future__ import annotations

from hiltest.world.sensors.register_device import RegisterDevice

from ..sensors.bus_master import read, write

RATE_HZ, SAMPLE_BYTES = 200, 6


def polled(part: RegisterDevice, control: int, value: int, *, until_s: float) -> list[bytes]:
    """Switch a part on at 0.06 s and read each sample from 0.075 s on as soon as it is there."""
    assert write(part, 0.06, control, value)
    ticks = range(15, round(until_s * RATE_HZ))
    return [read(part, tick / RATE_HZ + 1e-6, 0x01, SAMPLE_BYTES) for tick in ticks]
