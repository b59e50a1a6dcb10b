"""Fields of currents, magnets and cables, against closed forms and integrals of Biot and Savart."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.constants import mu_0
from scipy.integrate import quad_vec

from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.world import EarthField, MagneticDistortion, World
from hiltest.world.disturbances import Cable, Current, Disturbances, Passing

MOTOR = Current((0.5, -0.3, 0.2), ((10.0, 0.0), (12.0, 8.0), (20.0, 8.0), (20.0, 1.0), (30.0, 0.0)))
COMPONENT = st.floats(-5.0, 5.0)
VECTOR = st.tuples(COMPONENT, COMPONENT, COMPONENT)


def biot_savart_ut(points, tangents, at):
    """Return the integrand of a thin current of 1 A through a point of it, at a place [uT]."""
    r = np.asarray(at) - points
    return 1e6 * mu_0 / (4.0 * math.pi) * np.cross(tangents, r) / np.linalg.norm(r) ** 3


def test_a_waveform_is_straight_between_its_rows_and_steps_where_two_are_at_one_time():
    times = (0.0, 10.0, 11.0, 12.0, 19.999, 20.0, 25.0, 30.0, 1e6)
    assert [MOTOR.current_a(time_s) for time_s in times] == [0.0, 0.0, 4.0, 8.0, 8.0, 1.0, 0.5, 0.0, 0.0]


def test_a_waveform_that_repeats_begins_again_from_its_first_row():
    pulses = Current((1.0, 0.0, 0.0), ((5.0, 0.0), (5.0, 2.0), (6.0, 2.0), (6.0, 0.0)), repeat_s=4.0)
    assert [pulses.current_a(time_s) for time_s in (0.0, 4.9, 5.0, 5.5, 6.0, 8.9, 9.0, 9.5, 10.0)] == [
        0.0,
        0.0,
        2.0,
        2.0,
        0.0,
        0.0,
        2.0,
        2.0,
        0.0,
    ]


def test_the_field_of_a_current_is_proportional_to_it():
    assert MOTOR.field_ut(11.0) == pytest.approx((2.0, -1.2, 0.8), abs=1e-15)
    assert MOTOR.field_ut(0.0) == (0.0, 0.0, 0.0)


def test_a_dipole_on_its_axis_has_twice_the_opposite_field_that_it_has_beside_it():
    # 300 A m2 at 2 m: mu0/4pi m/r^3 is 3.75 uT.
    ahead = Passing((300.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.0), at_s=7.0)
    beside = Passing((300.0, 0.0, 0.0), (0.0, 2.0, 0.0), (1.0, 0.0, 0.0), at_s=7.0)
    assert ahead.field_ned_ut(7.0) == pytest.approx((7.5, 0.0, 0.0), rel=1e-12)
    assert beside.field_ned_ut(7.0) == pytest.approx((-3.75, 0.0, 0.0), rel=1e-12)
    # A second later it is hypot(2, 1) m away.
    r = np.array([2.0, 1.0, 0.0])
    along = r / math.sqrt(5.0)
    right = 0.1 * (3.0 * 300.0 * along[0] * along - np.array([300.0, 0.0, 0.0])) / 5.0**1.5
    assert ahead.field_ned_ut(8.0) == pytest.approx(right, rel=1e-12)


@settings(max_examples=20)  # an integral each
@given(st.tuples(COMPONENT, COMPONENT, st.floats(1.0, 5.0)))
def test_a_dipole_is_what_a_small_loop_of_current_is(place):
    """Far from a loop of radius a its field is a dipole's, to (a/r)^2."""
    radius_m, at_s = 0.01, 3.0
    moment_am2 = math.pi * radius_m**2  # of 1 A, about the down axis

    def element(angle):
        points = radius_m * np.array([math.cos(angle), math.sin(angle), 0.0])
        tangents = radius_m * np.array([-math.sin(angle), math.cos(angle), 0.0])
        return biot_savart_ut(points + place, tangents, np.zeros(3))

    loop, _ = quad_vec(element, 0.0, 2.0 * math.pi, epsrel=1e-10, epsabs=1e-15)
    dipole = Passing((0.0, 0.0, moment_am2), place, (1.0, 0.0, 0.0), at_s).field_ned_ut(at_s)
    # Next order: below 15/8 (a/r)^2 of the largest that it is in any direction.
    assert np.abs(loop - dipole).max() <= 4.0 * radius_m**2 * 0.2 * moment_am2


@given(VECTOR, st.tuples(COMPONENT, COMPONENT, st.floats(0.5, 5.0)), VECTOR, st.floats(-2.0, 2.0))
def test_what_passes_has_no_source_and_no_curl_at_the_part(moment, place, velocity, gone_s):
    """The derivatives by the place of the part, and so of the magnet: a symmetric matrix without trace."""
    step_m = 1e-4
    away = [p + v * gone_s for p, v in zip(place, velocity, strict=True)]
    assume(math.hypot(*away) >= 0.5)

    def field(shift):
        shifted = tuple(p + s for p, s in zip(place, shift, strict=True))
        return np.array(Passing(moment, shifted, velocity, at_s=1.0).field_ned_ut(1.0 + gone_s))

    gradient = np.array([(field(step) - field(-step)) / (2.0 * step_m) for step in step_m * np.eye(3)])
    # Rounding of two fields over the step, and the third derivative, at 0.5 m 5!/2 of the field over r^3, times step^2.
    slack = 1e-3 * 0.2 * math.hypot(*moment) / math.hypot(*away) ** 4 + 1e-10
    assert abs(np.trace(gradient)) <= slack
    assert np.abs(gradient - gradient.T).max() <= slack


def test_a_cable_has_the_field_of_a_long_wire_around_it():
    # 10 A forward, 0.2 m under the part: 0.2 uT m/A times 10 A over 0.2 m, to the left of who looks along the current
    # from above it, by the right hand.
    cable = Cable(10.0, (2.0, 0.0, 0.0), ((0.0, 0.0, 0.0, 1000.0), (5.0, 0.0, 0.0, 1000.0), (5.0, 7.0, 0.0, 0.2)))
    assert cable.field_ut(4.9) == (0.0, 0.0, 0.0)
    assert cable.field_ut(5.0) == pytest.approx((0.0, 10.0, 0.0), abs=0.0021)  # less the 2 nT of its first place


@settings(max_examples=20)  # two integrals each
@given(VECTOR.filter(lambda item: math.hypot(*item) > 0.5), st.tuples(*[st.floats(0.3, 3.0)] * 3))
def test_a_cable_is_the_integral_of_biot_and_savart_along_it(direction, place):
    along = np.array(direction) / math.hypot(*direction)
    first = (0.0, -4.0, 9.0)
    assume(min(np.linalg.norm(np.cross(along, item)) for item in (place, first)) >= 0.1)

    def integral(through):
        # tan substitutes the whole line by a finite stretch.
        result, _ = quad_vec(
            lambda u: biot_savart_ut(np.array(through) + math.tan(u) * along, along / math.cos(u) ** 2, np.zeros(3)),
            -0.5 * math.pi,
            0.5 * math.pi,
            epsrel=1e-9,
            epsabs=1e-9,
        )
        return result

    cable = Cable(12.0, direction, ((0.0, *first), (1.0, *place)))
    # Closed form and integral: 1e-6 of the field and of what the integral was asked for.
    assert np.allclose(cable.field_ut(2.0), 12.0 * (integral(place) - integral(first)), rtol=1e-6, atol=1e-6)


@given(st.floats(0.0, 360.0), st.floats(-80.0, 80.0), st.floats(-180.0, 180.0))
def test_what_passes_stays_where_it_is_when_the_body_turns_and_what_is_the_bodys_turns_with_it(heading, pitch, roll):
    passing = Passing((300.0, -100.0, 50.0), (1.0, 2.0, -0.5), (1.0, 0.0, 0.0), at_s=0.0)
    cable = Cable(10.0, (0.0, 1.0, 0.0), ((0.0, 0.1, 0.0, 0.3), (1.0, 0.1, 0.0, 0.2)))
    pose = Pose(heading, pitch, roll)
    by_cause_ut = Disturbances(MOTOR, passing, cable).fields_by_cause_ut(15.0, pose)
    turned = rotation_body_from_ned(pose) @ passing.field_ned_ut(15.0)
    assert np.allclose(by_cause_ut["passing"], turned, atol=1e-12)
    assert by_cause_ut["current"] == MOTOR.field_ut(15.0)
    assert by_cause_ut["cable"] == cable.field_ut(15.0)


def test_soft_iron_bends_what_passes_and_not_what_is_measured_at_the_part():
    field = EarthField(48.5, 62.0)
    distortion = MagneticDistortion(((1.1, 0.1, 0.0), (0.1, 0.9, 0.0), (0.0, 0.0, 1.2)), (1.0, 2.0, 3.0))
    passing = Passing((300.0, 0.0, 0.0), (0.0, 2.0, 0.0), (1.0, 0.0, 0.0), at_s=15.0)
    world = World(field, pose=Pose(40.0, 10.0, -20.0), disturbances=Disturbances(MOTOR, passing))
    rotation = rotation_body_from_ned(Pose(40.0, 10.0, -20.0))
    outside = rotation @ np.add(field.ned_ut, (-3.75, 0.0, 0.0))
    right = np.array(distortion.soft_iron) @ outside + distortion.hard_iron_ut + np.array([4.0, -2.4, 1.6])
    assert np.allclose(world.field_at_part_ut(distortion, 15.0), right, atol=1e-12)


def test_a_world_without_disturbances_is_the_same_to_the_last_bit():
    field = EarthField(48.5, 62.0)
    distortion = MagneticDistortion(hard_iron_ut=(0.1, 0.2, 0.3))
    plain, nothing = World(field), World(field, disturbances=Disturbances())
    for time_s in (0.0, 1.7, 33.0):
        same = distortion.apply(plain.state_at(time_s).field_body_ut)
        assert plain.field_at_part_ut(distortion, time_s) == nothing.field_at_part_ut(distortion, time_s) == same
