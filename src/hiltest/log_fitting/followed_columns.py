"""Columns of a log that the hard iron follows: a motor's current, a throttle, a temperature."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.following import fit_following
from hiltest.errors import CalibrationError, ConfigError
from hiltest.interfaces.sensor_files.cells import LARGEST_READING, number_or_nan
from hiltest.interfaces.sensor_files.columns import column_index
from hiltest.interfaces.sensor_files.table import open_table
from hiltest.log_fitting.fit_result import FollowedColumn, Following
from hiltest.log_fitting.left_out import left_out
from hiltest.log_fitting.rating import triple
from hiltest.log_fitting.samples import Samples
from hiltest.log_fitting.span import rows

# The hard iron is stated at zero if the log comes this close to it, in parts of the largest value; else at the mean.
_NEAR_ZERO = 0.1
# Unit at the end of a header, after a separator.
_UNIT = re.compile(r"[_\s([]+(m?A|degC|°?C|K|m?V|%|us)[)\]]?$")


def subtract_followed(samples: Samples, names: Sequence[str], *, robust: bool = True) -> tuple[Samples, Following]:
    """Return samples without the iron that follows some columns, and that iron; see `fit_following`.

    Parameters
    ----------
    samples
        Samples from a file, which is read again.
    names
        Columns, each by its name in the header or its number from 1.
    robust
        True to fit without the readings that are omitted from the result.

    Raises
    ------
    ConfigError
        When there is no such column, or it does not determine the iron.
    """
    labels, values = _read_columns(samples, names)
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    samples, values = rows(samples, known), values[known]
    if not len(values):
        raise ConfigError(f"{samples.path}: no reading has numbers in {', '.join(names)}")
    least, largest = np.abs(values).min(axis=0), np.abs(values).max(axis=0)
    references = np.where(least <= _NEAR_ZERO * largest, 0.0, values.mean(axis=0))
    values = values - references
    try:
        iron = fit_following(samples.points, values)
        if robust:
            gone = left_out(replace(samples, points=samples.points - values @ iron.vectors))
            used = ~(gone.repeated | gone.dropped)
            iron = fit_following(samples.points[used], values[used])
    except CalibrationError as error:
        raise ConfigError(f"{samples.path}: {', '.join(names)}: {error}") from error
    rest = replace(samples, points=samples.points - values @ iron.vectors)
    columns = (
        FollowedColumn(name, unit, triple(vector), float(error), float(reference))
        for (name, unit), vector, error, reference in zip(labels, iron.vectors, iron.errors, references, strict=True)
    )
    return rest, Following(tuple(columns), iron.before_percent, iron.after_percent, 100.0 * iron.explained)


def following_sentences(following: Following, unit: str) -> list[str]:
    """Return the iron that follows columns in words, with its effect."""
    sentences = []
    for column in following.columns:
        vector = " ".join(f"{value:.4g}" for value in column.vector)
        per = column.unit or f"unit of {column.name}"
        sentences.append(
            f"The hard iron follows {column.name}: {vector} {unit} per {per}, +- {column.error:.2g}; it is stated at "
            f"{column.reference:.4g}."
        )
    sentences.append(
        f"That explains {following.explained_percent:.0f} % of the spread: the residual is "
        f"{following.before_percent:.2f} % without and {following.after_percent:.2f} % with it. All figures, also as "
        "read, are those of readings from which it is subtracted."
    )
    return sentences


def _read_columns(samples: Samples, names: Sequence[str]) -> tuple[list[tuple[str, str]], NDArray[np.float64]]:
    """Return names and units, and the values at the samples, shape (n, columns); NaN where there is no number."""
    path = samples.path
    if samples.lines is None or not path.is_file():
        raise ConfigError(f"{path}: --with reads the log twice: give it as a file")
    table = open_table(path)
    places = [column_index(name, table.headers, table.width, option="--with") for name in names]
    by_line = {row.line: [number_or_nan(row.cells[place], LARGEST_READING) for place in places] for row in table.rows()}
    labels = []
    for name, place in zip(names, places, strict=True):
        header = table.headers[place] if table.headers else name
        unit = _UNIT.search(header)
        labels.append((header, unit[1] if unit else ""))
    missing = [math.nan] * len(places)
    return labels, np.array([by_line.get(line, missing) for line in samples.lines.tolist()], dtype=np.float64)
