"""Noise is a function of seed, sensor, epoch and sample number, and it is normal."""

from statistics import NormalDist

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import kstest

from hiltest.world.noise import NoiseSource, normal_quantiles

ALL_ONES = 2**64 - 1


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        # Known answers for philox4x64-10 that its authors publish with Random123.
        ((0,) * 4, (0,) * 2, "16554d9eca36314c db20fe9d672d0fdc d7e772cee186176b 7e68b68aec7ba23b"),
        ((ALL_ONES,) * 4, (ALL_ONES,) * 2, "87b092c3013fe90b 438c3c67be8d0224 9cc7d7c69cd777b6 a09caebf594f0ba0"),
        (
            (0x243F6A8885A308D3, 0x13198A2E03707344, 0xA4093822299F31D0, 0x082EFA98EC4E6C89),
            (0x452821E638D01377, 0xBE5466CF34E90C6C),
            "a528f45403e61d95 38c72dbd566e9788 a5a1610e72fd18b5 57bd43b5e52b7fe6",
        ),
    ],
)
def test_the_generator_gives_the_published_known_answers(counter, key, words):
    number = sum(word << 64 * place for place, word in enumerate(counter))
    before = (number - 1) % 2**256  # numpy counts up before each block
    generator = np.random.Philox(counter=before, key=sum(word << 64 * place for place, word in enumerate(key)))
    assert [f"{word:016x}" for word in generator.random_raw(4)] == words.split()


def test_the_table_is_the_same_on_every_host():
    # An entry could come out differently only if it lay at a rounding boundary to within the error of
    # the inverse, some 1e-15. None is nearer than 1e-12 (in sigmas), a thousand times that.
    inverse = NormalDist().inv_cdf
    scaled = np.array([inverse(0.5 + (k + 0.5) / 65536) * 2**20 for k in range(32768)])
    to_boundary = np.abs(scaled - np.floor(scaled) - 0.5)
    assert to_boundary.min() / 2**20 > 1e-12


def test_the_table_agrees_with_another_inverse():
    exact = ndtri((np.arange(65536) + 0.5) / 65536)
    assert np.abs(normal_quantiles() - exact).max() <= 2.0**-21 + 1e-12  # half a step of the grid


def test_the_table_is_symmetric_and_has_unit_variance():
    table = normal_quantiles()
    assert np.array_equal(table, -table[::-1])
    # Mid-interval quantiles leave out the spread within an interval, and the tails beyond 4.3 sigma.
    assert np.mean(table**2) == pytest.approx(1.0, abs=2e-4)


def test_the_first_samples_are_pinned():
    # Multiples of 2**-20; another value on some host or numpy would change every run's record.
    source = NoiseSource(1, "mag3110@0e")
    drawn = [source.sample(0, 0), source.sample(2 << 32, 700)]
    assert [tuple(value * 2**20 for value in triple) for triple in drawn] == [
        (-2330292, 35962, -56798),
        (-2482724, -87231, -136363),
    ]


def test_a_sample_does_not_depend_on_what_was_asked_before():
    forward, backward = NoiseSource(5, "part"), NoiseSource(5, "part")
    numbers = range(0, 1000, 7)
    asked = {number: forward.sample(3, number) for number in numbers}
    assert {number: backward.sample(3, number) for number in reversed(numbers)} == asked


def test_seed_sensor_and_epoch_each_give_other_noise():
    reference = stream(NoiseSource(1, "a"), 0)
    for other in (stream(NoiseSource(2, "a"), 0), stream(NoiseSource(1, "b"), 0), stream(NoiseSource(1, "a"), 1)):
        # Independent standard normals: correlation within 5 / sqrt(n).
        assert np.abs(np.mean(reference * other)) < 5.0 / np.sqrt(reference.size)


def test_samples_are_independent_standard_normals():
    values = stream(NoiseSource(11, "a"), 0, count=20_000)
    assert kstest(values.ravel(), "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(values.T) - np.eye(3)).max() < 5.0 / np.sqrt(20_000)
    lagged = np.mean(values[1:] * values[:-1], axis=0)
    assert np.abs(lagged).max() < 5.0 / np.sqrt(20_000)


def stream(source, epoch, count=5000):
    return np.array([source.sample(epoch, number) for number in range(count)])
