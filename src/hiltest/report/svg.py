"""Draw axes, points and lines as inline SVG. Colours come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from hiltest.report.legible import legible
from hiltest.report.marks import KeyEntry, Mark, shape

_LEFT, _RIGHT, _TOP, _BOTTOM = 68.0, 14.0, 14.0, 44.0
_DIGIT = 10.0  # wider than a digit of the 15 px that the page has on a telephone
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
        Read out by a screen reader: its ``title`` and ``desc``. The title is also the caption.
    x_label, y_label : str
    x_range, y_range : tuple of float
        Ends of the axes.
    x_ticks : sequence of float, optional
        Where the x axis is labelled; chosen when not given.
    width, height : float
        Of the view box. The page scales it.
    log_x, log_y : bool
        Whether an axis is logarithmic; all its numbers are then above 0.
    key : list of KeyEntry
        What its lines and marks stand for; the page writes it above the drawing, where it wraps as text does.
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
    log_x: bool = False
    log_y: bool = False
    key: list[KeyEntry] = field(default_factory=list)
    _shapes: list[Markup] = field(default_factory=list)

    def place(self, x: float, y: float) -> Point:
        """Return view box coordinates of a data point."""
        across = _share(x, self.x_range, logarithmic=self.log_x)
        up = _share(y, self.y_range, logarithmic=self.log_y)
        width, height = self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM
        return _LEFT + across * width, _TOP + (1.0 - up) * height

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

    def marks(self, points: Iterable[Point], style: str, mark: Mark = Mark.DOT, *, radius: float = 3.5) -> None:
        """Draw points as marks."""
        self._shapes += [mark.at(*self.place(*point), radius, style) for point in points]

    def circle(self, centre: Point, radius: float, style: str) -> None:
        """Draw a circle whose radius is in units of x."""
        x, y = self.place(*centre)
        edge, _ = self.place(centre[0] + radius, centre[1])
        self._add('<circle class="{}" cx="{}" cy="{}" r="{}"/>', style, x, y, edge - x)

    def column(self, left: float, right: float, text: str) -> None:
        """Say something about all between two values of x, to who points there."""
        (x, bottom), (end, top) = self.place(left, self.y_range[0]), self.place(right, self.y_range[1])
        place = 'x="{}" y="{}" width="{}" height="{}"'
        template = f'<rect fill="none" pointer-events="all" {place}><title>{{}}</title></rect>'
        self._add(template, x, top, end - x, bottom - top, text)

    def note(self, at: Point, text: str) -> None:
        """Write beside a point, on the side where there is room."""
        x, y = self.place(*at)
        anchor, offset = ("end", -8) if x > self.width * 0.6 else ("start", 8)
        y = min(max(y, _TOP + 16), self.height - _BOTTOM - 6)
        self._add('<text class="note" x="{}" y="{}" text-anchor="{}">{}</text>', x + offset, y - 6, anchor, text)

    def upright(self, x: float, text: str, style: str) -> None:
        """Draw a line up at one value of x, with a text along it."""
        self.line([(x, self.y_range[0]), (x, self.y_range[1])], style)
        at, _ = self.place(x, self.y_range[1])
        template = '<text class="along" transform="translate({} {}) rotate(-90)" text-anchor="end">{}</text>'
        self._add(template, at - 4, _TOP + 2, text)

    def svg(self) -> Markup:
        """Return the finished drawing."""
        return drawing(
            self.title, self.description, self.width, self.height, Markup("").join([*self._axes(), *self._shapes])
        )

    def _axes(self) -> Iterator[Markup]:
        yield from self._x_axis()
        yield from self._y_axis()

    def _x_axis(self) -> Iterator[Markup]:
        ticks = self.x_ticks or (log_ticks if self.log_x else nice_ticks)(*self.x_range)
        free_from = 0.0
        for value in ticks:
            x, bottom = self.place(value, self.y_range[0])
            yield shape('<path class="grid" d="M{} {}V{}"/>', x, _TOP, bottom)
            label = f"{value:g}"
            half = _DIGIT / 2.0 * len(label)
            inside = min(x, self.width - half)  # a long number at the right end is not cut
            if inside - half >= free_from:  # nor does one lie on another
                yield shape('<text x="{}" y="{}" text-anchor="middle">{}</text>', inside, bottom + 17.0, label)
                free_from = inside + half
        middle = (_LEFT + self.width - _RIGHT) / 2
        yield shape('<text x="{}" y="{}" text-anchor="middle">{}</text>', middle, self.height - 6, self.x_label)

    def _y_axis(self) -> Iterator[Markup]:
        for value in (log_ticks if self.log_y else nice_ticks)(*self.y_range):
            left, y = self.place(self.x_range[0], value)
            yield shape('<path class="grid" d="M{} {}H{}"/>', left, y, self.width - _RIGHT)
            yield shape('<text x="{}" y="{}" text-anchor="end">{}</text>', left - 6, y + 4, f"{value:g}")
        yield shape(
            '<text transform="translate(13 {}) rotate(-90)" text-anchor="middle">{}</text>',
            (_TOP + self.height - _BOTTOM) / 2, self.y_label,
        )

    def _add(self, template: str, *values: object) -> None:
        self._shapes.append(shape(template, *values))


def drawing(title: str, description: str, width: float, height: float, content: Markup) -> Markup:
    """Return an SVG element that says in words what it shows."""
    return Markup(
        '<svg viewBox="0 0 {:g} {:g}" role="img"><title>{}</title><desc>{}</desc>{}</svg>'
    ).format(width, height, legible(title), legible(description), content)


def _share(value: float, ends: Point, *, logarithmic: bool) -> float:
    """Return where between two ends a value lies, 0 to 1."""
    low, high = ends
    if logarithmic:
        low, high, value = math.log10(low), math.log10(high), math.log10(value)
    return (value - low) / (high - low)
