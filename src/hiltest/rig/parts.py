"""The sensor parts of a board: bus, place, names in the firmware, and model of each.

Importing this module is cheap: the models are imported when a rig names one of its own, or when a board is built.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

from hiltest.errors import nearest_hint
from hiltest.measurement.sensor_registers import GROUP
from hiltest.rig.toml_tables import Axes, RigValueError, SensorPart, Triple, require

if TYPE_CHECKING:
    from hiltest.rig.world import SimulatedWorld
    from hiltest.world import World
    from hiltest.world.sensors import AccelerometerErrors, Drift, Fxos8700cq, RegisterDevice, TableSensor
    from hiltest.world.sensors.register_table import RegisterTable

_NONE: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Part:
    """One part on an I2C or SPI bus."""

    bus: str
    """Module of the chip, such as ``i2c1``."""
    address: int
    """7-bit address on an I2C bus."""
    make: Callable[[World, SimulatedWorld, int, Part], RegisterDevice]
    """Creates the model from the world, the rig's table of it, the noise seed, and this part."""
    sensors: Mapping[str, str]
    """Name of each of its sensors in the packaged firmware, by kind."""
    interrupts: Mapping[str, str] = field(default_factory=dict)
    """Pins of the processor by the part's pins that are wired to them."""
    magnetometer_range_ut: float | None = None
    """Range of a magnetometer axis, data sheet."""
    magnetometer_noise_ut: Callable[[SimulatedWorld], float] = lambda _truth: 0.0
    """Returns the rms noise of its magnetometer as the packaged firmware configures it."""
    magnetometer_offset_ut: Callable[[SimulatedWorld], Triple] = lambda _truth: _NONE
    """Returns the zero-flux offset of its magnetometer, body frame."""
    kinds: tuple[str, ...] = ()
    """Names of the part's devices in their register tables."""
    prefix: str = ""
    """Text before these names for the second part of a kind, such as ``onboard-``."""
    chip_select: str | None = None
    """Pin that selects it on an SPI bus."""
    pins: tuple[str, ...] = ("INT1", "INT2")
    """Interrupt pins that the part has."""
    companion_addresses: tuple[int, ...] = ()
    companion_chip_selects: tuple[str, ...] = ()
    """7-bit addresses of the further devices in its package, and their pins on an SPI bus."""
    axes: Axes | None = None
    """Axes of the part along x, y and z of the board, if a rig may change them."""

    @property
    def number(self) -> int:
        """Number of the bus among those of its kind."""
        return int(self.bus[-1])

    @property
    def places(self) -> tuple[int | str, ...]:
        """Address or chip select of the part and of each further device that is on the bus, too."""
        if self.chip_select is None:
            return self.address, *self.companion_addresses
        return self.chip_select, *self.companion_chip_selects


def _mag3110(world: World, truth: SimulatedWorld, seed: int, part: Part) -> RegisterDevice:
    from hiltest.world import MagneticDistortion
    from hiltest.world.sensors import Mag3110

    return Mag3110(
        world,
        MagneticDistortion(truth.soft_iron, truth.hard_iron_ut),
        seed=seed,
        address=part.address,
        axes=part.axes,
        noise_ut=truth.mag3110_noise_ut,
        drift=_drift(gain_percent=truth.drift.mag3110_gain_percent_per_degc),
    )


def _fxos8700cq(world: World, truth: SimulatedWorld, seed: int, part: Part) -> Fxos8700cq:
    from hiltest.world import MagneticDistortion
    from hiltest.world.sensors import Fxos8700cq, Fxos8700cqNoise

    drift = truth.drift
    return Fxos8700cq(
        world,
        MagneticDistortion(truth.soft_iron, truth.hard_iron_at_ut(PARTS["fxos8700cq"])),
        seed=seed,
        address=part.address,
        name="shield" if part.bus == "i2c1" else "onboard",
        errors=_accelerometer_errors(truth),
        noise=Fxos8700cqNoise(magnetometer_ut=truth.fxos8700cq_noise_ut),
        magnetometer_drift=_drift(
            offset=drift.fxos8700cq_zero_flux_ut_per_degc, gain_percent=drift.fxos8700cq_gain_percent_per_degc
        ),
    )


def _fxas21002c(world: World, truth: SimulatedWorld, seed: int, part: Part) -> RegisterDevice:
    from hiltest.world.sensors import Fxas21002c

    return Fxas21002c(
        world,
        seed=seed,
        address=part.address,
        bias_dps=truth.gyroscope_bias_dps,
        drift=_drift(offset=truth.drift.gyroscope_bias_dps_per_degc),
        noise_density=1e-3 * truth.gyroscope_noise_mdps_per_rthz,
        response=truth.gyroscope_response,
    )


_FXOS8700CQ = Part(
    "i2c1",
    0x1E,
    _fxos8700cq,
    {"magnetometer": "FXOS8700CQ magnetometer", "accelerometer": "FXOS8700CQ accelerometer"},
    {"INT1": "PTB9", "INT2": "PTB23"},
    1200.0,
    lambda truth: math.sqrt(math.prod(truth.fxos8700cq_noise_ut)),
    lambda truth: truth.fxos8700cq_zero_flux_ut,
    ("FXOS8700CQ",),
)
#: The parts by their names in a rig's ``world.fitted``: those of the FRDM-FXS-MULTI-B shield on I2C1 with its factory
#: jumpers (its MAG3110's pin is not connected then), and the one on the board itself, on I2C0, whose INT1 shares its
#: pin with the button SW2. A MAG3110's word also holds its own zero-flux offset of up to 1000 uT.
PARTS: Mapping[str, Part] = {
    "mag3110": Part(
        "i2c1",
        0x0E,
        _mag3110,
        {"magnetometer": "MAG3110"},
        magnetometer_range_ut=2000.0,
        magnetometer_noise_ut=lambda truth: truth.mag3110_noise_ut[0],
        kinds=("MAG3110",),
        pins=("INT1",),
        axes=("-y", "-x", "z"),
    ),
    "fxos8700cq": _FXOS8700CQ,
    "fxas21002c": Part("i2c1", 0x20, _fxas21002c, {"gyroscope": "FXAS21002C"}, {"INT1": "PTA2"}, kinds=("FXAS21002C",)),
    "onboard-fxos8700cq": replace(
        _FXOS8700CQ,
        bus="i2c0",
        address=0x1D,
        sensors={kind: f"on-board {name}" for kind, name in _FXOS8700CQ.sensors.items()},
        interrupts={"INT1": "PTC6", "INT2": "PTC13"},
        prefix="onboard-",
    ),
}
#: The models of hiltest by their names in ``[[sensors.parts]]``; a user's have an entry point of the group `GROUP`.
MODELS: Mapping[str, str] = {
    "bmm150": "hiltest.world.sensors.bmm150:Bmm150",
    "i3g4250d": "hiltest.world.sensors.i3g4250d:I3g4250d",
    "icm20948": "hiltest.world.sensors.icm20948:Icm20948",
    "mma8653": "hiltest.world.sensors.mma8653:Mma8653",
    "lis3mdl": "hiltest.world.sensors.lis3mdl:Lis3mdl",
    "lsm303agr": "hiltest.world.sensors.lsm303agr_a:Lsm303agrA",
    "lsm6ds3trc": "hiltest.world.sensors.lsm6ds3trc:Lsm6ds3trc",
    "lsm9ds1": "hiltest.world.sensors.lsm9ds1_ag:Lsm9ds1Ag",
    "mmc5603": "hiltest.world.sensors.mmc5603:Mmc5603",
    "qmc5883p": "hiltest.world.sensors.qmc5883p:Qmc5883p",
    "rm3100": "hiltest.world.sensors.rm3100:Rm3100",
}
# Keys of a rig that only the models of `MODELS` and of users carry out: of their quantities, and further ones.
_OF_QUANTITIES = (
    "magnetometer_noise_ut",
    "accelerometer_noise_mg",
    "gyroscope_noise_dps",
    "magnetometer_offset_ut",
    "accelerometer_offset_mg",
    "gyroscope_bias_dps",
    "magnetometer_offset_ut_per_degc",
    "magnetometer_gain_percent_per_degc",
)
_OF_MODELS = ("axes", *_OF_QUANTITIES)


def fitted_parts(truth: SimulatedWorld, entries: tuple[SensorPart, ...] | None) -> dict[str, Part]:
    """Return the fitted parts by name: those of ``world.fitted``, and those of ``[[sensors.parts]]``.

    Raises
    ------
    RigValueError
        If an entry names an unknown part or pin, or two parts have one name or one place.
    """
    parts = {name: PARTS[name] for name in truth.fitted}
    named: set[str] = set()
    for index, entry in enumerate(entries or ()):
        key, name = f"sensors.parts.{index}", entry.name or entry.part
        require(name not in named, key, f"is the second part {name!r}: give it a name of its own")
        named.add(name)
        part = _described(entry, key)
        strangers = [pin for pin in entry.interrupts if pin not in part.pins]
        has = f"it has {', '.join(part.pins)}" if part.pins else "it has no interrupt pin"
        require(not strangers, f"{key}.interrupts", f"{entry.part} has no pin {' or '.join(strangers)}; {has}")
        parts[name] = part
    _refuse_shared_places(parts, entries or ())
    return parts


def _refuse_shared_places(parts: Mapping[str, Part], entries: tuple[SensorPart, ...]) -> None:
    places: dict[tuple[str, int | str], str] = {}
    for name, place in [(name, place) for name, part in parts.items() for place in part.places]:
        part = parts[name]
        other = places.setdefault((part.bus, place), name)
        if other == name:
            continue
        index = max(index for index, entry in enumerate(entries) if (entry.name or entry.part) in (name, other))
        at = f"chip select {place}" if isinstance(place, str) else f"address 0x{place:02x}"
        key = "chip_select" if isinstance(place, str) else "address"
        remedy = "use another pin" if isinstance(place, str) else "use another address, if one of them has it, or bus"
        if shield := {name, other} - {entry.name or entry.part for entry in entries}:
            remedy += f", or leave {shield.pop()} out of world.fitted"
        message = f"{name} and {other} have the same {at} on {part.bus}: {remedy}"
        require(False, f"sensors.parts.{index}.{key}", message)
    wired: dict[str, str] = {}
    for name, part in parts.items():
        for pin in (*part.interrupts.values(), *(place for place in part.places if isinstance(place, str))):
            other = wired.setdefault(pin, name)
            index = max(
                (k for k, entry in enumerate(entries) if (entry.name or entry.part) in (name, other)), default=0
            )
            message = f"{name} and {other} are both wired to {pin}: use another pin"
            require(other == name, f"sensors.parts.{index}", message)


def _described(entry: SensorPart, key: str) -> Part:
    """Return the part of an entry."""
    if entry.part in PARTS:
        part = PARTS[entry.part]
        strangers = [name for name in _OF_MODELS if getattr(entry, name) is not None]
        if part.axes is not None and entry.axes is not None:
            part, strangers = replace(part, axes=entry.axes), [name for name in strangers if name != "axes"]
        require(not strangers, f"{key}.{(*strangers, '')[0]}", f"is a key of [world] for {entry.part}")
        require(entry.chip_select is None, f"{key}.bus", f"{entry.part} has a model for I2C only")
        require(entry.companion_address is None, f"{key}.companion_address", f"{entry.part} is one device")
        return replace(
            part,
            bus=entry.bus,
            address=part.address if entry.address is None else entry.address,
            interrupts=entry.interrupts or part.interrupts,
            sensors={kind: f"{entry.name} {name}" if entry.name else name for kind, name in part.sensors.items()},
            prefix=f"{entry.name}-" if entry.name else part.prefix,
        )
    model = load_model(entry.part, f"{key}.part")
    table = model.table
    addresses = table.addresses
    require(entry.chip_select is None or table.has_spi, f"{key}.bus", f"{entry.part} has I2C only")
    kinds = {row.quantity.key for row in model.every_output()}
    strangers = [
        name for name in _OF_QUANTITIES if getattr(entry, name) is not None and name.split("_")[0] not in kinds
    ]
    require(not strangers, f"{key}.{(*strangers, '')[0]}", f"{entry.part} measures {' and '.join(sorted(kinds))} only")
    require(bool(addresses) or entry.chip_select is not None, f"{key}.bus", f"{entry.part} has no I2C: name an SPI bus")
    require(
        entry.address is None or entry.address in addresses,
        f"{key}.address",
        f"{entry.part} answers at {' or '.join(f'0x{address:02x}' for address in addresses)} only",
    )
    companions = [device.table for device in model.companion_models]
    _check_companions(entry, key, companions)
    return Part(
        entry.bus,
        (addresses or (0,))[0] if entry.address is None else entry.address,
        partial(_make_model, model, entry),
        _sensor_names(model, f"{entry.name} {entry.part.upper()}" if entry.name else entry.part.upper()),
        entry.interrupts,
        next((row.range for row in model.every_output() if row.quantity.key == "magnetometer"), None),
        lambda _truth: _declared_noise(model, entry),
        lambda _truth: entry.magnetometer_offset_ut or _NONE,
        tuple(device.table.part for device in (model, *model.companion_models)),
        f"{entry.name}-" if entry.name else "",
        entry.chip_select,
        model.every_pin(),
        tuple(entry.companion_address or companion.addresses[0] for companion in companions),
        (entry.companion_chip_select,) if entry.companion_chip_select else (),
    )


def _check_companions(entry: SensorPart, key: str, companions: Sequence[RegisterTable]) -> None:
    """Refuse a place that the further devices of a package do not have."""
    addresses = [address for companion in companions for address in companion.addresses]
    require(
        entry.companion_address is None or entry.companion_address in addresses,
        f"{key}.companion_address",
        f"the further device of {entry.part} answers at {' or '.join(f'0x{address:02x}' for address in addresses)} only"
        if addresses
        else f"{entry.part} is one device",
    )
    on_spi = [companion.part for companion in companions if companion.has_spi and entry.chip_select is not None]
    require(
        bool(on_spi) == (entry.companion_chip_select is not None),
        f"{key}.companion_chip_select",
        f"name the chip select of the {on_spi[0]} in this package"
        if on_spi
        else f"{entry.part} has no further device on an SPI bus",
    )


def load_model(name: str, key: str = "part") -> type[TableSensor]:
    """Return the model of a part by its name in a rig.

    Raises
    ------
    RigValueError
        If there is none, or it is no model.
    """
    from hiltest.world.sensors import TableSensor

    own = {entry_point.name: entry_point.value for entry_point in entry_points(group=GROUP)}
    places = {**own, **MODELS}
    require(name in places, key, f"no part {name!r}; {nearest_hint(name, [*PARTS, *places])}")
    module, _, attribute = places[name].partition(":")
    try:
        model = getattr(import_module(module), attribute, None)
    except Exception as error:  # a user's module may raise anything
        message = f"{places[name]} cannot be imported, {type(error).__name__}: {error}"
        raise RigValueError(key, message) from error
    require(
        isinstance(model, type) and issubclass(model, TableSensor),
        key,
        f"{places[name]} is no subclass of TableSensor: correct the entry point {name}",
    )
    return model  # type: ignore[return-value]


def _make_model(
    model: type[TableSensor], entry: SensorPart, world: World, truth: SimulatedWorld, seed: int, part: Part
) -> RegisterDevice:
    from hiltest.world import MagneticDistortion
    from hiltest.world.recorded_motion import Sensed
    from hiltest.world.sensors import SensorSetup

    noise = {
        Sensed.MAGNETOMETER: entry.magnetometer_noise_ut,
        Sensed.ACCELEROMETER: scaled_or_none(entry.accelerometer_noise_mg, 1e-3),
        Sensed.GYROSCOPE: entry.gyroscope_noise_dps,
    }
    errors, gain_percent = _accelerometer_errors(truth), entry.magnetometer_gain_percent_per_degc
    drifts = entry.magnetometer_offset_ut_per_degc is not None or gain_percent is not None
    return model(
        SensorSetup(
            world,
            seed,
            entry.name or "",
            part.address,
            entry.axes or ("x", "y", "z"),
            MagneticDistortion(truth.soft_iron, truth.hard_iron_at_ut(part)),
            replace(errors, offset_g=_sum(errors.offset_g, scaled(entry.accelerometer_offset_mg or _NONE, 1e-3))),
            truth.gyroscope_response,
            _sum(truth.gyroscope_bias_dps, entry.gyroscope_bias_dps or _NONE),
            _drift(offset=truth.drift.gyroscope_bias_dps_per_degc),
            _drift(offset=entry.magnetometer_offset_ut_per_degc or _NONE, gain_percent=gain_percent or _NONE)
            if drifts
            else None,
            {quantity: rms for quantity, rms in noise.items() if rms is not None},
            entry.companion_address,
        )
    )


def _sensor_names(model: type[TableSensor], name: str) -> dict[str, str]:
    """Return the name of each sensor by kind: the part's name, with the kind if there are several."""
    kinds = [row.quantity.key for row in model.every_output()]
    return {kind: name if len(kinds) == 1 else f"{name} {kind}" for kind in kinds}


def _declared_noise(model: type[TableSensor], entry: SensorPart) -> float:
    if entry.magnetometer_noise_ut is not None:
        return entry.magnetometer_noise_ut
    return next(row.noise for row in model.every_output() if row.quantity.key == "magnetometer")


def sensor_names(parts: Mapping[str, Part]) -> dict[str, list[str]]:
    """Return the names of all parts' sensors in the packaged firmware, by kind, such as ``magnetometer``."""
    names: dict[str, list[str]] = {}
    for part in {**PARTS, **parts}.values():
        for kind, name in part.sensors.items():
            names.setdefault(kind, []).append(name)
    return names


def _accelerometer_errors(truth: SimulatedWorld) -> AccelerometerErrors:
    from hiltest.world.sensors import AccelerometerErrors

    gain_x, gain_y, gain_z = truth.accelerometer_gain_error_percent
    row_x, row_y, row_z = truth.accelerometer_cross_axis_percent
    x, y, z = truth.accelerometer_offset_mg
    return AccelerometerErrors(
        (x / 1000.0, y / 1000.0, z / 1000.0),
        (gain_x / 100.0, gain_y / 100.0, gain_z / 100.0),
        (scaled(row_x, 1e-2), scaled(row_y, 1e-2), scaled(row_z, 1e-2)),
        _drift(offset=scaled(truth.drift.accelerometer_offset_mg_per_degc, 1e-3)),
    )


def _drift(*, offset: Triple = _NONE, gain_percent: Triple = _NONE) -> Drift:
    from hiltest.world.sensors import Drift

    return Drift(offset, scaled(gain_percent, 1e-2))


def scaled(triple: Triple, factor: float) -> Triple:
    """Multiply each of three numbers."""
    x, y, z = triple
    return (factor * x, factor * y, factor * z)


def scaled_or_none(value: float | None, factor: float) -> float | None:
    """Multiply a number, if there is one."""
    return None if value is None else factor * value


def _sum(first: Triple, second: Triple) -> Triple:
    x, y, z = (one + other for one, other in zip(first, second, strict=True))
    return (x, y, z)
