"""Firmware that sends the packets of NXP's sensor fusion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hiltest.interfaces.packet_fields import Packet
from hiltest.interfaces.packet_stream import PacketDecoder
from hiltest.interfaces.packets import (
    AltitudePacket,
    AnglesPacket,
    KalmanPacket422,
    KalmanPacket500,
    MagneticPacket7,
    MagneticPacket422,
    MainPacket,
    RatePacket,
    Release,
    Shown,
)
from hiltest.interfaces.quantities import Moment, Observation, Quantity

_COMMAND_LENGTH = 4


class FsflkInterface:
    """Decoder of the packets of a release of NXP's sensor fusion.

    Parameters
    ----------
    algorithm
        Command that is sent at the start; empty for none.

    Attributes
    ----------
    offers : frozenset of Quantity
    not_understood : int
        Bytes that belong to no packet.
    buffer : dict of int to (3,) int
        The firmware's buffer of uncalibrated samples by cell [counts of 0.1 uT], as far as it was sent.
    """

    offers = frozenset(
        {
            Quantity.HEADING,
            Quantity.PITCH,
            Quantity.ROLL,
            Quantity.QUATERNION,
            Quantity.ACCELEROMETER_CALIBRATED,
            Quantity.MAGNETOMETER_CALIBRATED,
            Quantity.GYROSCOPE,
            Quantity.GYROSCOPE_CALIBRATED,
            Quantity.HARD_IRON,
            Quantity.INVERSE_SOFT_IRON,
            Quantity.FIELD_STRENGTH,
            Quantity.DIP,
            Quantity.FIT_ERROR,
            Quantity.GYROSCOPE_BIAS,
            Quantity.CALIBRATED,
            Quantity.TEMPERATURE,
        }
    )

    def __init__(self, release: Release, algorithm: str = "") -> None:
        self._decoder = PacketDecoder(release)
        self._algorithm = algorithm
        self._diagonal: tuple[float, ...] = ()  # diagonal of the inverse soft iron, until the other elements arrive
        self.buffer: dict[int, tuple[int, int, int]] = {}
        self.not_understood = 0

    def commands(self, moment: Moment) -> bytes:
        """Return the algorithm's command at the start, and nothing later."""
        return (
            self._algorithm.ljust(_COMMAND_LENGTH).encode("ascii")
            if moment is Moment.START and self._algorithm
            else b""
        )

    def feed(self, data: bytes, time_s: float) -> Sequence[Observation]:
        """Decode bytes; return one observation per packet."""
        batch = self._decoder.feed(data)
        self.not_understood += batch.lost_bytes
        batch_values = (self._values(packet) for packet in batch.packets())
        return [Observation(time_s, values) for values in batch_values if values]

    def _values(self, packet: Packet) -> dict[Quantity, NDArray[np.float64]]:
        values: dict[Quantity, Sequence[float]] = {}
        if isinstance(packet, AnglesPacket):
            values = {
                Quantity.HEADING: [packet.compass_deg],
                Quantity.PITCH: [packet.pitch_deg],
                Quantity.ROLL: [packet.roll_deg],
            }
        elif isinstance(packet, MainPacket):
            values = {Quantity.QUATERNION: packet.rotation}
            # The firmware sends zeros for a sensor that the algorithm does not use.
            for quantity, vector in (
                (Quantity.ACCELEROMETER_CALIBRATED, packet.acceleration_g),
                (Quantity.MAGNETOMETER_CALIBRATED, packet.field_ut),
                (Quantity.GYROSCOPE, packet.rate_dps),
            ):
                if any(vector):
                    values[quantity] = vector
        elif isinstance(packet, RatePacket):
            values = {Quantity.GYROSCOPE_CALIBRATED: packet.rate_dps}
        elif isinstance(packet, AltitudePacket):
            values = {Quantity.TEMPERATURE: [packet.temperature_degc]}
        elif isinstance(packet, KalmanPacket422 | KalmanPacket500):
            values = {Quantity.GYROSCOPE_BIAS: packet.gyroscope_offset_dps}
        elif isinstance(packet, MagneticPacket7 | MagneticPacket422):
            values = self._magnetic(packet)
        return {quantity: np.array(numbers, dtype=np.float64) for quantity, numbers in values.items()}

    def _magnetic(self, packet: MagneticPacket7 | MagneticPacket422) -> dict[Quantity, Sequence[float]]:
        values: dict[Quantity, Sequence[float]] = {Quantity.FIT_ERROR: [packet.fit_error_percent]}
        shown = [*packet.shown_values.values()]
        if isinstance(packet, MagneticPacket7):
            values[Quantity.FIELD_STRENGTH] = [packet.field_strength_ut]
        elif packet.shown is Shown.STRENGTH:
            values[Quantity.FIELD_STRENGTH] = [shown[0]]
        if packet.shown is Shown.STRENGTH:
            values[Quantity.DIP] = [shown[-1]]
        elif packet.shown is Shown.HARD_IRON:
            values[Quantity.HARD_IRON] = shown
            values[Quantity.CALIBRATED] = [float(any(shown))]  # there is no calibration at power-on
        elif packet.shown is Shown.INVERSE_SOFT_IRON_DIAGONAL:
            self._diagonal = tuple(shown)
        elif packet.shown is Shown.INVERSE_SOFT_IRON_OFF_DIAGONAL and self._diagonal:
            (xx, yy, zz), (xy, xz, yz) = self._diagonal, shown
            values[Quantity.INVERSE_SOFT_IRON] = [xx, xy, xz, xy, yy, yz, xz, yz, zz]
        elif packet.buffer_cell is not None:
            self._keep(packet.buffer_cell, packet)
        return values

    def _keep(self, cell: int, packet: MagneticPacket7 | MagneticPacket422) -> None:
        if packet.shown is Shown.BUFFER_CELL:
            self.buffer[cell] = packet.variable
        else:
            self.buffer.pop(cell, None)
