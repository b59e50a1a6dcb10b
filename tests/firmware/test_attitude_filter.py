"""The attitude filter's C against its float64 reference, on this machine and on the emulated core, and its cycles."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import hiltest
from hiltest.orientation.attitude_errors import attitude_errors
from hiltest.orientation.attitude_filter import AttitudeFilter, AttitudeFilterSettings, AttitudeFilterStatus
from hiltest.orientation.motion_recording import read_motion_recording
from hiltest.virtual.board.k64f import VirtualK64F

from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture
from ..orientation.filters import (
    ORIENTATION,
    FilterState,
    FirmwareFilter,
    Motion,
    build,
    floats,
    swaying_motion,
)
from ..orientation.quaternion_algebra import angle_between_deg

ELF = Path(hiltest.__file__).parent / "firmware" / "hiltest-frdm-k64f.elf"
CYCLE_MODEL = "cortex-m4-trm/3"
LIMIT_CYCLES = 1000
WORST_CYCLES = 665
# A step's roundings: 6e-8 of some ten operations on a quaternion of norm 1, as an angle of twice that. They add up like
# noise over the heading's time constant of 2 000 steps: 45 times that of one step.
FLOAT32_DEG = math.degrees(45 * 10 * 2 * 6e-8)


@pytest.fixture(scope="module")
def library(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return build(require_tool("gcc"), tmp_path_factory.mktemp("attitude_filter"))


@pytest.fixture(scope="module")
def board() -> VirtualK64F:
    return VirtualK64F(ELF, profile=CYCLE_MODEL)


class OnBoard:
    """The shipped firmware's filter, called on a virtual board that did not boot."""

    def __init__(self, board: VirtualK64F) -> None:
        self._board = board
        self.state = bytearray(bytes(FilterState()))
        board.call("attitude_filter_init", self.state, bytes(floats([0.0, 0.0, 0.0])))
        self.cycles: list[int] = []

    def update(self, *readings: np.ndarray, dt_s: float) -> AttitudeFilterStatus:
        answer = self._board.call(
            "attitude_filter_update", self.state, *(bytes(floats(values)) for values in readings), dt_s
        )
        self.cycles.append(answer.cycles)
        return AttitudeFilterStatus(answer.value)


def noisy(motion: Motion, *, seed: int = 3, shocks: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rates, gravity and field with noise of 0.6 deg/s and 2 %; shocks of 8 g and a magnet in some samples."""
    generator = np.random.default_rng(seed)
    shape = motion.gravity_g.shape
    rates = np.radians(motion.rates_dps) + generator.normal(0.0, 0.01, shape)
    gravity = motion.gravity_g + generator.normal(0.0, 0.02, shape)
    field = motion.field + generator.normal(0.0, 0.02, shape)
    if shocks:
        gravity[generator.random(len(gravity)) < 0.02] *= 8.0
        field[650:700] += (0.5, -1.0, 2.0)
    return rates, gravity, field


@pytest.mark.parametrize("shocks", [False, True])
def test_float32_follows_float64_on_random_motion(library: ctypes.CDLL, shocks: bool) -> None:
    for seed in range(5):
        # At 97 Hz no sample is exactly at the end of a mean.
        motion = swaying_motion(20.0, hz=97.0, seed=seed)
        expected, firmware = AttitudeFilter((0.0, 0.0, 0.0)), FirmwareFilter(library)
        angles_deg, other_statuses = [], 0
        for readings in zip(*noisy(motion, seed=seed, shocks=shocks), strict=True):
            statuses = [form.update(*readings, motion.dt_s) for form in (firmware, expected)]
            other_statuses += statuses[0] is not statuses[1]
            angles_deg.append(angle_between_deg(firmware.attitude, expected.attitude))
        # Of 2000 samples one or two are within a rounding of the gate. Each adds its noise times its gain: three
        # deviations of 2.3 degrees times 0.01 s * 2 / 6 s.
        assert other_statuses <= 2, seed
        assert max(angles_deg) < FLOAT32_DEG + other_statuses * 3 * 2.3 * 0.01 * 2 / 6, seed


@pytest.mark.parametrize(
    "name", ["07_undisturbed_fast_rotation_B", "34_disturbed_attached_magnet_3cm"], ids=["fast", "magnet"]
)
def test_float32_errs_as_float64_on_recorded_motion(
    library: ctypes.CDLL,
    shared_data: Callable[[str], Path],  # noqa: F811 (the fixture)
    name: str,
) -> None:
    recording = read_motion_recording(shared_data(f"broad/{name}.npz"))
    bias = recording.rest_bias_rad_s()
    gravity_g = -recording.acceleration_m_s2 / 9.80665
    expected, firmware = AttitudeFilter(bias), FirmwareFilter(library, bias)
    attitudes = np.empty((2, len(gravity_g), 4))
    columns = (recording.gyroscope_rad_s.tolist(), gravity_g.tolist(), recording.field_ut.tolist())
    for index, readings in enumerate(zip(*columns, strict=True)):
        for form, attitude_filter in enumerate((firmware, expected)):
            attitude_filter.update(*readings, 1.0 / recording.rate_hz)
            attitudes[form, index] = attitude_filter.attitude
    # A field within a rounding of the gate may count in one form and not in the other: of 50 000, some do.
    assert attitude_errors(*attitudes).total_deg.max() < 0.02
    float32, float64 = (attitude_errors(form, recording.truth).score(recording.movement) for form in attitudes)
    assert float32 is not None
    assert float64 is not None
    assert float32.total_deg == pytest.approx(float64.total_deg, abs=0.005)


def test_the_emulated_core_computes_the_same_bits_as_this_machine(library: ctypes.CDLL, board: VirtualK64F) -> None:
    motion = swaying_motion(8.0)
    firmware, on_board = FirmwareFilter(library), OnBoard(board)
    for readings in zip(*noisy(motion, shocks=True), strict=True):
        assert on_board.update(*readings, dt_s=motion.dt_s) is firmware.update(*readings, motion.dt_s)
        assert bytes(on_board.state)[:56] == bytes(firmware.state)[:56]


def test_an_update_costs_at_most_598_cycles(board: VirtualK64F) -> None:
    """Virtual cycles are exact: 519 in the first 6 s, and 536 afterwards, or 540 if the field is left out.

    The first attitude takes 598.
    """
    on_board = OnBoard(board)
    motion = swaying_motion(8.0)
    costs: dict[str, set[int]] = {}
    for readings in zip(*noisy(motion, shocks=True), strict=True):
        status = on_board.update(*readings, dt_s=motion.dt_s)
        costs.setdefault(status.name, set()).add(on_board.cycles[-1])
    print(costs)
    assert costs == {"OK": {598, 519, 536}, "FIELD_LEFT_OUT": {540}}


def test_no_readings_take_more_than_1000_cycles(board: VirtualK64F) -> None:
    """Steps of half a turn, shocks, magnets, readings that are refused, and first attitudes of all directions."""
    generator = np.random.default_rng(11)
    results, cycles = set(), []
    for steps in (*[2] * 60, 300):
        on_board = OnBoard(board)
        for _ in range(steps):
            rates = generator.normal(0.0, 10.0 ** generator.uniform(-2.0, 1.6), 3)
            gravity, field = generator.normal(0.0, 10.0 ** generator.uniform(-1.0, 2.0), (2, 3))
            results.add(on_board.update(rates, gravity, field, dt_s=0.05))
        cycles += on_board.cycles
    print(sorted(set(cycles)))
    assert results == {AttitudeFilterStatus.OK, AttitudeFilterStatus.FIELD_LEFT_OUT, AttitudeFilterStatus.BAD_STEP}
    assert max(cycles) == WORST_CYCLES
    assert max(cycles) <= LIMIT_CYCLES


def test_the_firmware_has_the_times_of_the_reference() -> None:
    header = (ORIENTATION / "attitude_filter.h").read_text(encoding="utf-8")
    constants = {
        name.lower(): float(value)
        for name, value in re.findall(r"^#define ATTITUDE_FILTER_(\w+) ([0-9.]+)f$", header, re.M)
    }
    assert constants == asdict(AttitudeFilterSettings())
