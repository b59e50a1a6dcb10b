"""The sensor parts of the bench: bus address, names in the firmware, and model of each.

Importing this module is cheap: the models are imported when a board is built.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hiltest.rig.toml_tables import Triple

if TYPE_CHECKING:
    from hiltest.rig.world import SimulatedWorld
    from hiltest.world import World
    from hiltest.world.sensors import AccelerometerErrors, Drift, Fxos8700cq, RegisterDevice


@dataclass(frozen=True, slots=True)
class Part:
    """One part on an I2C bus."""

    bus: int
    address: int
    """I2C module, and the part's 7-bit address."""
    make: Callable[[World, SimulatedWorld, int, Part], RegisterDevice]
    """Creates the model from the world, the rig's table of it, the noise seed, and this part."""
    sensors: Mapping[str, str]
    """Name of each of its sensors in the packaged firmware, by kind."""
    pins: tuple[str | None, str | None] = field(default=(None, None))
    """Pins of the processor that its INT1 and INT2 are wired to."""
    magnetometer_range_ut: float | None = None
    """Range of a magnetometer axis, data sheet."""


def _mag3110(world: World, truth: SimulatedWorld, seed: int, _part: Part) -> RegisterDevice:
    from hiltest.world import MagneticDistortion
    from hiltest.world.sensors import Mag3110

    return Mag3110(
        world,
        MagneticDistortion(truth.soft_iron, truth.hard_iron_ut),
        seed=seed,
        noise_ut=truth.mag3110_noise_ut,
        drift=_drift(gain_percent=truth.drift.mag3110_gain_percent_per_degc),
    )


def _fxos8700cq(world: World, truth: SimulatedWorld, seed: int, part: Part) -> Fxos8700cq:
    from hiltest.world import MagneticDistortion
    from hiltest.world.sensors import Fxos8700cq, Fxos8700cqNoise

    drift = truth.drift
    return Fxos8700cq(
        world,
        MagneticDistortion(truth.soft_iron, truth.hard_iron_at_ut("fxos8700cq")),
        seed=seed,
        address=part.address,
        name="shield" if part.bus == 1 else "onboard",
        errors=_accelerometer_errors(truth),
        noise=Fxos8700cqNoise(magnetometer_ut=truth.fxos8700cq_noise_ut),
        magnetometer_drift=_drift(
            offset=drift.fxos8700cq_zero_flux_ut_per_degc, gain_percent=drift.fxos8700cq_gain_percent_per_degc
        ),
    )


def _fxas21002c(world: World, truth: SimulatedWorld, seed: int, _part: Part) -> RegisterDevice:
    from hiltest.world.sensors import Fxas21002c

    return Fxas21002c(
        world,
        seed=seed,
        bias_dps=truth.gyroscope_bias_dps,
        drift=_drift(offset=truth.drift.gyroscope_bias_dps_per_degc),
        noise_density=1e-3 * truth.gyroscope_noise_mdps_per_rthz,
        response=truth.gyroscope_response,
    )


def _microbit_mag3110(world: World, truth: SimulatedWorld, seed: int, _part: Part) -> RegisterDevice:
    from hiltest.world import MagneticDistortion
    from hiltest.world.sensors import Mag3110

    return Mag3110(
        world,
        MagneticDistortion(truth.soft_iron, truth.hard_iron_ut),
        seed=seed,
        body_axes=(-2, 1, -3),
        noise_ut=truth.mag3110_noise_ut,
        drift=_drift(gain_percent=truth.drift.mag3110_gain_percent_per_degc),
    )


def _microbit_mma8653(world: World, truth: SimulatedWorld, seed: int, _part: Part) -> RegisterDevice:
    from hiltest.world.sensors import Mma8653

    return Mma8653(world, seed=seed, body_axes=(2, -1, -3), errors=_accelerometer_errors(truth))


#: The parts of the BBC micro:bit v1.3, on the back of the board: x to the right, y to the edge with the contacts.
MICROBIT_PARTS: Mapping[str, Part] = {
    "microbit-mag3110": Part(0, 0x0E, _microbit_mag3110, {"magnetometer": "MAG3110"}, ("P0.29", None), 2000.0),
    "microbit-mma8653": Part(0, 0x1D, _microbit_mma8653, {"accelerometer": "MMA8653"}, ("P0.28", "P0.27")),
}
#: The parts by their names in a rig's ``world.fitted``: those of the FRDM-FXS-MULTI-B shield on I2C1 with its factory
#: jumpers (its MAG3110's pin is not connected then), and the one on the board itself, on I2C0, whose INT1 shares its
#: pin with the button SW2. A MAG3110's word also holds its own zero-flux offset of up to 1000 uT.
FRDM_K64F_PARTS: Mapping[str, Part] = {
    "mag3110": Part(1, 0x0E, _mag3110, {"magnetometer": "MAG3110"}, magnetometer_range_ut=2000.0),
    "fxos8700cq": Part(
        1,
        0x1E,
        _fxos8700cq,
        {"magnetometer": "FXOS8700CQ magnetometer", "accelerometer": "FXOS8700CQ accelerometer"},
        ("PTB9", "PTB23"),
        1200.0,
    ),
    "fxas21002c": Part(1, 0x20, _fxas21002c, {"gyroscope": "FXAS21002C"}, ("PTA2", None)),
    "onboard-fxos8700cq": Part(
        0,
        0x1D,
        _fxos8700cq,
        {"magnetometer": "on-board FXOS8700CQ magnetometer", "accelerometer": "on-board FXOS8700CQ accelerometer"},
        ("PTC6", "PTC13"),
        1200.0,
    ),
}
PARTS: Mapping[str, Part] = {**FRDM_K64F_PARTS, **MICROBIT_PARTS}


def sensor_names() -> dict[str, list[str]]:
    """Return the names of all parts' sensors in the packaged firmware, by kind, such as ``magnetometer``."""
    names: dict[str, list[str]] = {}
    for part in PARTS.values():
        for kind, name in part.sensors.items():
            names.setdefault(kind, []).append(name)
    return names


def _accelerometer_errors(truth: SimulatedWorld) -> AccelerometerErrors:
    from hiltest.world.sensors import AccelerometerErrors

    x, y, z = truth.accelerometer_offset_mg
    gain_x, gain_y, gain_z = truth.accelerometer_gain_error_percent
    row_x, row_y, row_z = truth.accelerometer_cross_axis_percent
    return AccelerometerErrors(
        (x / 1000.0, y / 1000.0, z / 1000.0),
        (gain_x / 100.0, gain_y / 100.0, gain_z / 100.0),
        (scaled(row_x, 1e-2), scaled(row_y, 1e-2), scaled(row_z, 1e-2)),
        _drift(offset=scaled(truth.drift.accelerometer_offset_mg_per_degc, 1e-3)),
    )


def _drift(*, offset: Triple = (0.0, 0.0, 0.0), gain_percent: Triple = (0.0, 0.0, 0.0)) -> Drift:
    from hiltest.world.sensors import Drift

    return Drift(offset, scaled(gain_percent, 1e-2))


def scaled(triple: Triple, factor: float) -> Triple:
    """Multiply each of three numbers."""
    x, y, z = triple
    return (factor * x, factor * y, factor * z)
