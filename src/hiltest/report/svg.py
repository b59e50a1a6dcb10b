"""Draw axes, points and lines as inline SVG. Colours come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup, escape

_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 14.0, 14.0, 40.0
_DIGIT = 8.0  # wider than a digit of the page's 12 px
_TICKS = (1.0, 2.0, 2.5, 5.0, 10.0)

Point = tuple[float, float]


def nice_ticks(low: float, high: float, *, about: int = 5) -> tuple[float, ...]:
    """Return round numbers from `low` to `high`, roughly `about` of them.

    Examples
    --------
    >>> nice_ticks(-2.1, 2.1)
    (-2.0, -1.0, 0.0, 1.0, 2.0)
    """
    if not high > low:
        raise ValueError(f"axis from {low} to {high} is empty")
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in _TICKS if factor * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return tuple(index * step + 0.0 for index in range(first, last + 1))


def log_ticks(low: float, high: float) -> tuple[float, ...]:
    """Return the numbers from `low` to `high` that are 1, 2 or 5 times a power of ten.

    Examples
    --------
    >>> log_ticks(0.3, 4.0)
    (0.5, 1.0, 2.0)
    """
    if not 0.0 < low < high:
        raise ValueError(f"logarithmic axis from {low} to {high}")
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = (float(f"{digit}e{power}") for power in powers for digit in (1, 2, 5))
    return tuple(value for value in values if low <= value <= high)


@dataclass(slots=True)
class Figure:
    """One plot. Data coordinates in, SVG out.

    Attributes
    ----------
    title, description : str
        Read out by a screen reader; the title is also the caption.
    x_label, y_label : str
    x_range, y_range : tuple of float
        Ends of the axes.
    x_ticks : sequence of float, optional
        Where the x axis is labelled; chosen when not given.
    width, height : float
        Of the view box. The page scales it.
    headroom : float
        Left free above the plot, for a key.
    logarithmic : bool
        Both axes; all numbers are then above 0.
    """

    title: str
    description: str
    x_label: str
    y_label: str
    x_range: Point
    y_range: Point
    x_ticks: Sequence[float] = ()
    width: float = 460.0
    height: float = 260.0
    headroom: float = 0.0
    logarithmic: bool = False
    _shapes: list[Markup] = field(default_factory=list)

    def place(self, x: float, y: float) -> Point:
        """Return view box coordinates of a data point."""
        (x_low, x_high), (y_low, y_high) = self.x_range, self.y_range
        if self.logarithmic:
            x_low, x_high, y_low, y_high, x, y = map(math.log10, (x_low, x_high, y_low, y_high, x, y))
        across, down = self.width - _LEFT - _RIGHT, self.height - self._top - _BOTTOM
        return _LEFT + (x - x_low) / (x_high - x_low) * across, self._top + (y_high - y) / (y_high - y_low) * down

    @property
    def _top(self) -> float:
        return _TOP + self.headroom

    def band(self, low: float, high: float, style: str) -> None:
        """Shade everything between two values of y."""
        left, top = self.place(self.x_range[0], high)
        right, bottom = self.place(self.x_range[1], low)
        shape = '<rect class="{}" x="{}" y="{}" width="{}" height="{}"/>'
        self._add(shape, style, left, top, right - left, bottom - top)

    def level(self, y: float, style: str) -> None:
        """Draw a line across at one value of y."""
        self.line([(self.x_range[0], y), (self.x_range[1], y)], style)

    def line(self, points: Iterable[Point], style: str) -> None:
        """Join points by straight lines."""
        path = "L".join(f"{x:.1f} {y:.1f}" for x, y in (self.place(*point) for point in points))
        self._add('<path class="{}" d="M{}"/>', style, path)

    def dots(self, points: Iterable[Point], style: str) -> None:
        """Draw points as dots of one path: no element each, so a cloud stays small."""
        path = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in (self.place(*point) for point in points))
        self._add('<path class="{}" d="{}"/>', style, path)

    def rings(self, points: Iterable[Point], style: str, *, radius: float = 3.5) -> None:
        """Draw points as circles."""
        for x, y in (self.place(*point) for point in points):
            self._add('<circle class="{}" cx="{}" cy="{}" r="{}"/>', style, x, y, radius)

    def circle(self, centre: Point, radius: float, style: str) -> None:
        """Draw a circle whose radius is in units of x."""
        x, y = self.place(*centre)
        edge, _ = self.place(centre[0] + radius, centre[1])
        self._add('<circle class="{}" cx="{}" cy="{}" r="{}"/>', style, x, y, edge - x)

    def note(self, at: Point, text: str) -> None:
        """Write beside a point, on the side where there is room."""
        x, y = self.place(*at)
        anchor, offset = ("end", -8) if x > self.width * 0.6 else ("start", 8)
        y = min(max(y, self._top + 10), self.height - _BOTTOM - 6)
        self._add('<text class="note" x="{}" y="{}" text-anchor="{}">{}</text>', x + offset, y - 6, anchor, text)

    def upright(self, x: float, text: str, style: str) -> None:
        """Draw a line up at one value of x, with a text along it."""
        self.line([(x, self.y_range[0]), (x, self.y_range[1])], style)
        at, _ = self.place(x, self.y_range[1])
        template = '<text class="along" transform="translate({} {}) rotate(-90)" text-anchor="end">{}</text>'
        self._add(template, at - 4, self._top + 2, text)

    def key(self, entries: Iterable[tuple[str, str]]) -> None:
        """Name styles of lines above the plot, two in a row; needs a headroom of 16 a row."""
        across = self.width - _LEFT - _RIGHT
        for index, (text, style) in enumerate(entries):
            row, column = divmod(index, 2)
            x, y = _LEFT + across * column / 2.0, _TOP + 4.0 + 16.0 * row
            self._add('<path class="{}" d="M{} {}h22"/>', style, x, y - 4.0)
            self._add('<text x="{}" y="{}">{}</text>', x + 28.0, y, text)

    def svg(self) -> Markup:
        """Return the finished drawing."""
        return Markup(
            '<svg viewBox="0 0 {w:g} {h:g}" role="img" aria-label="{title}. {description}">{axes}{shapes}</svg>'
        ).format(
            w=self.width, h=self.height, title=self.title, description=self.description,
            axes=self._axes(), shapes=Markup("").join(self._shapes),
        )

    def _axes(self) -> Markup:
        parts = []
        ticks = log_ticks if self.logarithmic else nice_ticks
        for value in self.x_ticks or ticks(*self.x_range):
            x, bottom = self.place(value, self.y_range[0])
            parts.append(_shape('<path class="grid" d="M{} {}V{}"/>', x, self._top, bottom))
            label = f"{value:g}"
            inside = min(x, self.width - _DIGIT / 2.0 * len(label))  # a long number at the right end is not cut
            parts.append(_shape('<text x="{}" y="{}" text-anchor="middle">{}</text>', inside, bottom + 16, label))
        for value in ticks(*self.y_range):
            left, y = self.place(self.x_range[0], value)
            parts.append(_shape('<path class="grid" d="M{} {}H{}"/>', left, y, self.width - _RIGHT))
            parts.append(_shape('<text x="{}" y="{}" text-anchor="end">{}</text>', left - 6, y + 4, f"{value:g}"))
        middle, bottom = (_LEFT + self.width - _RIGHT) / 2, self.height - 6
        parts.append(_shape('<text x="{}" y="{}" text-anchor="middle">{}</text>', middle, bottom, self.x_label))
        parts.append(_shape(
            '<text transform="translate(13 {}) rotate(-90)" text-anchor="middle">{}</text>',
            (self._top + self.height - _BOTTOM) / 2, self.y_label,
        ))
        return Markup("").join(parts)

    def _add(self, template: str, *values: object) -> None:
        self._shapes.append(_shape(template, *values))


def _shape(template: str, *values: object) -> Markup:
    written = (f"{value:.1f}" if isinstance(value, float) else escape(str(value)) for value in values)
    return Markup(template).format(*written)
