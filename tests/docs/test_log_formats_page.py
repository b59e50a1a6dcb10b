"""The page of log formats: a log in the form of each of its examples gives its cloud back."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hiltest.calibration.corrected import fit_corrected
from hiltest.log_fitting import read_samples

PAGE = (Path(__file__).parents[2] / "docs" / "log-formats.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
# The readings of the examples, in uT, and the step of their times.
READINGS = ((34.59, -10.36, 54.82), (36.53, -9.37, 54.28))
STEP_S = 0.02
CENTRE = np.array([33.0, -12.0, 7.0])
# Half the last digit of MotionCal's readings, and a little.
_ROUNDING_UT = 0.06
_COUNT = 400


def cloud(count: int = _COUNT) -> NDArray[np.float64]:
    """Return readings of a sphere of 48.1 uT about the centre, shape (count, 3), with noise of 0.1 uT."""
    random = np.random.default_rng(7)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return CENTRE + 48.1 * directions + random.normal(0.0, 0.1, (count, 3))


def split(example: str) -> tuple[list[str], list[str], list[str], list[str]]:
    """Return the lines before the records of an example, those of its two records, and those behind them."""
    lines = example.splitlines()
    numbers = [[_value(text) for text in pattern(example).findall(line)] for line in lines]
    places = [
        next(at for at, values in enumerate(numbers) if any(_reading(value, number) for value in values))
        for number in (0, 1)
    ]
    period = places[1] - places[0]
    end = len(lines) - (lines[-1].startswith("]"))
    begin = end - 2 * period
    return lines[:begin], lines[begin : begin + period], lines[begin + period : end], lines[end:]


def pattern(example: str) -> re.Pattern[str]:
    """Return the form of numbers in an example."""
    decimal = "," if ";" in example and "." not in example else r"\."
    return re.compile(rf"[-+]?\d+(?:{decimal}\d+)?(?:[eE][-+]?\d+)?")


def written(text: str, value: Decimal) -> str:
    """Return a number in the form of another."""
    mantissa, _, exponent = text.upper().replace(",", ".").partition("E")
    decimals = len(mantissa.partition(".")[2])
    width = f"0{len(mantissa)}" if mantissa.startswith("0") else ""
    result = f"{value:.{max(decimals, 4)}e}" if exponent else format(value, f"{width}.{decimals}f")
    return result.replace(".", ",") if "," in text else result


def log(example: str, points: NDArray[np.float64]) -> tuple[str, float]:
    """Return a log of points in the form of an example, and the size of its unit [uT].

    Readings become those of the points; other numbers that differ between the two records go on as they begin.
    """
    above, first, second, below = split(example)
    number = pattern(example)
    parts, others = number.split("\n".join(first)), number.findall("\n".join(second))
    texts, sizes, rows = number.findall("\n".join(first)), set[float](), []
    columns: list[tuple[int, float] | None] = []
    for text, other in zip(texts, others, strict=True):
        columns.append(_reading(_value(text)))
        assert columns[-1] == _reading(_value(other), 1), "the second record has the same numbers"
        sizes |= {columns[-1][1]} if columns[-1] else set()
    assert len(sizes) == 1, "the readings of the example are those of this test"
    for row, point in enumerate(points):
        cells = []
        for text, other, column in zip(texts, others, columns, strict=True):
            value = _value(text) + row * (_value(other) - _value(text))
            value = Decimal(float(point[column[0]])) * Decimal(column[1]) if column else value
            cells.append(text if text == other and not column else written(text, value))
        rows.append("".join(part + cell for part, cell in zip(parts, [*cells, ""], strict=True)))
    rows[-1] = rows[-1].removesuffix(",") if below else rows[-1]
    return "\n".join([*above, *rows, *below]) + "\n", 1.0 / sizes.pop()


def _reading(value: Decimal, number: int = 0) -> tuple[int, float] | None:
    """Return the axis and the size of a number, if it is part of the first or second reading in some unit."""
    for axis, reading in enumerate(READINGS[number]):
        size = 10.0 ** round(math.log10(ratio)) if (ratio := float(value) / reading) > 0.0 else math.nan
        if abs(float(value) / size - reading) < _ROUNDING_UT:
            return axis, size
    return None


def _value(text: str) -> Decimal:
    return Decimal(text.replace(",", "."))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.splitlines()[0][:50])
def test_a_log_in_the_form_of_an_example_gives_its_cloud_back(tmp_path: Path, example: str) -> None:
    text, unit_ut = log(example, cloud())
    path = tmp_path / "log.txt"
    path.write_text(text, encoding="utf-8")
    samples = read_samples(path)
    assert len(samples.points) == _COUNT
    fit = fit_corrected((samples.microtesla or unit_ut) * samples.points)
    # The centre of 400 readings with 0.1 uT of noise is known to 0.01 uT; MotionCal's readings are rounded to 0.1 uT.
    np.testing.assert_allclose(fit.hard_iron, CENTRE, atol=0.1)
    if re.search(r"time|\bt\b", example, re.IGNORECASE):
        assert samples.time_s is not None
    if samples.time_s is not None and samples.time_s[-1] > samples.time_s[0]:
        # Seconds since 1970 have a last digit of 0.24 us.
        assert np.median(np.diff(samples.time_s)) == pytest.approx(STEP_S, abs=1e-6)
