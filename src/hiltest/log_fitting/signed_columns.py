"""Magnetometer samples whose columns an option names with signs, as ``--columns my,mx,-mz``."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from hiltest.log_fitting.samples import Samples, read_samples
from hiltest.measurement.units import FieldUnit


def read_signed_samples(
    path: Path, *, columns: str | None = None, unit: FieldUnit | None = None, accelerometer_columns: str | None = None
) -> Samples:
    """Read samples like `read_samples`; a minus before one of the magnetometer's columns negates it.

    Raises
    ------
    ConfigError
        See `read_samples`.
    """
    names = [name.strip() for name in next(csv.reader([columns or ""], skipinitialspace=True), [])]
    signs = [-1.0 if name.startswith("-") else 1.0 for name in names]
    if min(signs, default=1.0) > 0.0:
        return read_samples(path, columns=columns, unit=unit, accelerometer_columns=accelerometer_columns)
    bare = ",".join(
        f'"{name}"' if "," in name else name for name in (signed_name.removeprefix("-") for signed_name in names)
    )
    read = read_samples(path, columns=bare, unit=unit, accelerometer_columns=accelerometer_columns)
    signed = tuple(f"-{name}" if sign < 0.0 else name for name, sign in zip(read.columns, signs, strict=True))
    return replace(read, points=read.points * np.resize([*signs, 1.0], 3), columns=signed)
