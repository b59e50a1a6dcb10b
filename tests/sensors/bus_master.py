"""What a master on the I2C bus does, byte by byte: write registers, and read them."""

from __future__ import annotations

from hiltest.world.sensors.register_device import RegisterDevice


def write(part: RegisterDevice, time_s: float, register: int, *values: int) -> bool:
    """Write into a register and those behind it; say whether every value was acknowledged."""
    part.start(False, time_s)
    assert part.write(register, time_s)
    acknowledged = [part.write(value, time_s) for value in values]
    part.stop(time_s)
    return all(acknowledged)


def read(part: RegisterDevice, time_s: float, register: int, count: int) -> bytes:
    """Read so many bytes from a register on."""
    part.start(False, time_s)
    part.write(register, time_s)
    part.start(True, time_s)
    data = bytes(part.read(time_s) for _ in range(count))
    part.stop(time_s)
    return data
