"""The table ``[faults]``: injected faults of the line to the board, and of a virtual board."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from hiltest.rig.board_faults import BoardReset, HeldLine, SensorFault
from hiltest.rig.toml_tables import StrictTable, check_span, require

_MOST_LATE_S = 1e6
_WAYS = {"both": "both ways", "to-board": "on the way to the board", "to-host": "on the way from the board"}


@dataclass(frozen=True, slots=True)
class Late(StrictTable):
    """A delay of each byte by `by_s` with a probability; later bytes wait for it, because no byte overtakes another."""

    probability: float
    by_s: float

    def __post_init__(self) -> None:
        require(0.0 < self.probability <= 1.0, "probability", "must be above 0 and at most 1")
        require(0.0 < self.by_s <= _MOST_LATE_S, "by_s", f"must be above 0 and at most {_MOST_LATE_S:g}")


@dataclass(frozen=True, slots=True)
class Span(StrictTable):
    """An interval of `for_s` that begins `after_s` after the port is opened."""

    after_s: float
    for_s: float

    def __post_init__(self) -> None:
        check_span(self.after_s, self.for_s)

    def holds(self, since_s: float) -> bool:
        """Return whether a time since the opening of the port is in the interval."""
        return self.after_s <= since_s < self.after_s + self.for_s


@dataclass(frozen=True, slots=True)
class Absence(StrictTable):
    """Disappearance of the device `after_s` after the port is opened, until `back_after_s`, or for good."""

    after_s: float
    back_after_s: float | None = None

    def __post_init__(self) -> None:
        check_span(self.after_s)
        require(
            self.back_after_s is None or self.after_s < self.back_after_s,
            "back_after_s",
            "counts from the opening of the port too: it must be above after_s",
        )

    def holds(self, since_s: float) -> bool:
        """Return whether it is gone at a time since the opening of the port."""
        return self.after_s <= since_s and (self.back_after_s is None or since_s < self.back_after_s)


@dataclass(frozen=True, slots=True)
class OtherBaud(StrictTable):
    """Change of the board's line speed `after_s` after the port is opened."""

    after_s: float
    to: int

    def __post_init__(self) -> None:
        check_span(self.after_s)
        require(50 <= self.to <= 20_000_000, "to", "must be 50 to 20000000")


@dataclass(frozen=True, slots=True)
class Faults(StrictTable):
    """Faults of the line between host and board, and of a virtual board.

    All times are by the board's clock, since the opening of the port.
    """

    seed: int = 1
    """Seed that, with the index of a byte on the line, determines its faults."""
    direction: Literal["both", "to-board", "to-host"] = "both"
    """Affected direction; a disappearance affects both."""
    after_s: float = 0.0
    """Start of `lose`, `double`, `flip`, `split` and `late` [s]."""
    lose: float = 0.0
    double: float = 0.0
    flip: float = 0.0
    """Probability that a byte is lost, doubled, or has one wrong bit."""
    split: float = 0.0
    """Probability that a piece of bytes is split after a byte: the rest comes with the next read."""
    late: Late | None = None
    stall: Span | None = None
    """Interval in which bytes are held back."""
    disappear: Absence | None = None
    """Interval in which reading and writing fail as with a pulled cable."""
    baud: OtherBaud | None = None
    full_output: Span | None = None
    """Interval in which the port accepts no bytes: a write waits until its timeout and fails."""
    sensor: SensorFault | None = None
    held_line: HeldLine | None = None
    """Fault of an I2C bus."""
    reset: BoardReset | None = None

    def __post_init__(self) -> None:
        check_span(self.after_s)
        for key in ("lose", "double", "flip", "split"):
            require(0.0 <= getattr(self, key) <= 1.0, key, "is a probability, 0 to 1")
        require(self.lose + self.double + self.flip <= 1.0, "lose", "plus double plus flip exceed 1")
        require(
            self.has_line_faults or bool(self.board_faults),
            "seed",
            "has no fault: write one of lose, double, flip, split, "
            "late, stall, disappear, baud, full_output, sensor, held_line and reset beside it, or remove it",
        )
        require(
            self.full_output is None or self.direction != "to-host",
            "full_output",
            'applies only to the direction to the board, not to "to-host"',
        )

    @property
    def has_line_faults(self) -> bool:
        """True if the line has any fault."""
        return any(self._line_fault_texts())

    @property
    def board_faults(self) -> tuple[SensorFault | HeldLine | BoardReset, ...]:
        """Faults of the board."""
        return tuple(fault for fault in (self.sensor, self.held_line, self.reset) if fault is not None)

    @property
    def has_sensor_faults(self) -> bool:
        """True if a sensor or its bus has any fault."""
        return self.sensor is not None or self.held_line is not None

    def __str__(self) -> str:
        """Return all faults in words."""
        later = f" after {self.after_s:g} s" if self.after_s else ""
        line = ", ".join(self._line_fault_texts())
        texts = [f"{line}; {_WAYS[self.direction]}{later}, seed {self.seed}"] if line else []
        return "; ".join((*map(str, self.board_faults), *texts))

    def _line_fault_texts(self) -> Iterator[str]:
        hit = {"lose": "lost", "double": "doubled", "flip": "with a wrong bit", "split": "the last of a piece"}
        yield from (f"{share:g} of bytes {words}" for key, words in hit.items() if (share := getattr(self, key)))
        if self.late:
            yield f"{self.late.probability:g} of bytes late by {self.late.by_s:g} s"
        if self.stall:
            yield f"a stall after {self.stall.after_s:g} s for {self.stall.for_s:g} s"
        if self.disappear:
            back = self.disappear.back_after_s
            yield f"gone after {self.disappear.after_s:g} s" + ("" if back is None else f", back after {back:g} s")
        if self.baud:
            yield f"{self.baud.to} baud after {self.baud.after_s:g} s"
        if self.full_output:
            yield f"a full output buffer after {self.full_output.after_s:g} s for {self.full_output.for_s:g} s"
