"""Draw axes, points and lines as inline SVG. Colours come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import InitVar, dataclass, field
from itertools import count

from markupsafe import Markup

from hiltest.report.marks import KeyEntry, Mark, shape
from hiltest.text import format_number, legible

_LEFT, _RIGHT, _TOP, _BOTTOM = 68.0, 14.0, 14.0, 44.0
_LABEL = 24.0  # room that the plot gains if an axis has no label
_LARGEST = 1.2  # times the nominal size: letters keep their size in a wide column
_DIGIT, _LETTER = 10.0, 15.0  # wider than a digit of the 15 px that the page has on a telephone
_NARROW = 460.0  # a wider drawing gets larger letters on a telephone, which is this share of its width:
_LETTER_SHARE, _OUTSIDE = 0.0325, 16.0  # 11 px of 340; what letters may take of the margin beside the drawing
_TICK_ROOM, _FEWEST_TICKS = (75.0, 40.0), 3  # across and up
_MOST_LABELS = 10  # of a logarithmic axis
_TICKS = (1.0, 2.0, 2.5, 5.0, 10.0)

_ROW = Markup('<g data-row="{}"><title>{}</title>{}</g>')

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
    """Return the numbers from `low` to `high` that are 1, 2 or 5 times a power of ten; if they are many, powers only.

    Examples
    --------
    >>> log_ticks(0.3, 4.0)
    (0.5, 1.0, 2.0)
    """
    if not 0.0 < low < high:
        raise ValueError(f"logarithmic axis from {low} to {high}")
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)

    def ticks(every: int) -> tuple[float, ...]:
        """Return all ticks with 0, otherwise powers only, each or every second one, ..."""
        digits = (1,) if every else (1, 2, 5)
        values = (float(f"{digit}e{power}") for power in powers if power % max(every, 1) == 0 for digit in digits)
        return tuple(value for value in values if low <= value <= high)

    return next(labels for labels in map(ticks, count()) if len(labels) <= _MOST_LABELS)


@dataclass(frozen=True, slots=True)
class Sheet:
    """Numbers of a drawing as text; the first cell of a row is its name."""

    caption: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(slots=True)
class Figure:
    """One plot, from data coordinates to SVG."""

    title: str
    description: str
    """Texts for a screen reader: ``title`` and ``desc``. The title is also the caption."""
    x_label: str
    y_label: str
    """Labels of the axes; without a label the plot is larger."""
    x_range: Point
    y_range: Point
    """Ends of the axes."""
    x_ticks: Sequence[float] = ()
    """Labelled positions of the x axis; chosen automatically if empty."""
    width: float = 460.0
    height: float = 260.0
    """Size of the view box. The page scales it."""
    log_x: bool = False
    log_y: bool = False
    """True if an axis is logarithmic; all its numbers are then above 0."""
    equal_axes: InitVar[bool] = False
    """True if both axes have the same scale, so that a sphere is round; the height follows from the width."""
    key: list[KeyEntry] = field(default_factory=list)
    """Key of its lines and marks, which the page prints above the drawing."""
    sheet: Sheet | None = None
    """Numbers of its series."""
    _shapes: list[Markup] = field(default_factory=list)

    def __post_init__(self, equal_axes: bool) -> None:
        if equal_axes:
            left, top, right, bottom = self._frame
            (x_low, x_high), (y_low, y_high) = self.x_range, self.y_range
            self.height += (right - left) * (y_high - y_low) / (x_high - x_low) - (bottom - top)

    @property
    def is_wide(self) -> bool:
        """True if the page prints the labels of its axes beside it on a telephone."""
        return self.width > _NARROW

    @property
    def _frame(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the plot in the view box."""
        left, bottom = _LEFT - _LABEL * (not self.y_label), _BOTTOM - _LABEL * (not self.x_label)
        return left, _TOP, self.width - _RIGHT, self.height - bottom

    def place(self, x: float, y: float) -> Point:
        """Return view box coordinates of a data point."""
        across = _share(x, self.x_range, logarithmic=self.log_x)
        up = _share(y, self.y_range, logarithmic=self.log_y)
        left, top, right, bottom = self._frame
        return left + across * (right - left), top + (1.0 - up) * (bottom - top)

    def series(
        self,
        name: str,
        points: Sequence[Point],
        line: str = "",
        mark: Mark | None = None,
        *,
        mark_style: str = "",
        radius: float = 3.5,
        x_text: str = "",
    ) -> None:
        """Draw points under a name, as a line or marks or both, and add them to key and sheet.

        The sheet has `x_text` in place of the abscissas, if it is given.
        """
        if line and points:
            self.line(points, line)
        entry = KeyEntry(name, line, mark, mark_style or f"{line} filled")
        self.key += [] if entry in self.key else [entry]
        rows = self.sheet.rows if self.sheet else ()
        more = [(name, x_text or format_number(x), format_number(y)) for x, y in points]
        if mark:
            numbered = [(row, ", ".join(cells)) for row, cells in enumerate(more, len(rows))]
            self.marks(points, mark_style or f"{line} filled", mark, radius=radius, rows=numbered)
        self.sheet = Sheet(self.title, ("series", self.x_label or "x", self.y_label or "y"), [*rows, *more])

    def band(self, low: float, high: float, style: str) -> None:
        """Shade everything between two values of y."""
        left, top = self.place(self.x_range[0], high)
        right, bottom = self.place(self.x_range[1], low)
        shape = '<rect class="{}" x="{}" y="{}" width="{}" height="{}"/>'
        self._add(shape, style, left, top, right - left, bottom - top)

    def limit(self, limit: float | None) -> None:
        """Shade the allowed range about zero; nothing without a limit."""
        if limit is not None:
            self.band(-limit, limit, "allowed")
            self.level(limit, "limit")
            self.level(-limit, "limit")
            self.key.append(KeyEntry("limit", "limit"))

    def level(self, y: float, style: str) -> None:
        """Draw a horizontal line at one value of y."""
        self.line([(self.x_range[0], y), (self.x_range[1], y)], style)

    def line(self, points: Iterable[Point], style: str) -> None:
        """Join points by straight lines."""
        path = "L".join(f"{x:.1f} {y:.1f}" for x, y in (self.place(*point) for point in points))
        self._add('<path class="{}" d="M{}"/>', style, path)

    def dots(self, points: Iterable[Point], style: str) -> None:
        """Draw points as dots of one path, since an element for each of many samples would be large."""
        path = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in (self.place(*point) for point in points))
        self._add('<path class="{}" d="{}"/>', style, path)

    def bars(self, spans: Iterable[tuple[float, float, float]], style: str) -> None:
        """Draw vertical lines, each at one x between two values of y, as error bars."""
        ends = ((self.place(x, low), self.place(x, high)) for x, low, high in spans)
        path = "".join(f"M{x:.1f} {y:.1f}V{top:.1f}" for (x, y), (_, top) in ends)
        self._add('<path class="{}" d="{}"/>', style, path)

    def marks(
        self,
        points: Iterable[Point],
        style: str,
        mark: Mark = Mark.DOT,
        *,
        radius: float = 3.5,
        rows: Sequence[tuple[int, str]] = (),
    ) -> None:
        """Draw points as marks; `rows` are the row of the sheet that each belongs to, and its numbers in words."""
        drawn = [mark.draw(*self.place(*point), radius, style) for point in points]
        numbered = zip(rows, drawn, strict=True) if rows else ()
        self._shapes += [_ROW.format(row, legible(words), one) for (row, words), one in numbered] or drawn

    def circle(self, centre: Point, radius: float, style: str) -> None:
        """Draw a circle whose radius is in units of x."""
        x, y = self.place(*centre)
        edge, _ = self.place(centre[0] + radius, centre[1])
        self._add('<circle class="{}" cx="{}" cy="{}" r="{}"/>', style, x, y, edge - x)

    def upright(self, x: float, text: str, style: str, *, right: bool = False, low: bool = False) -> None:
        """Draw a vertical line at one value of x, with a text along it: above left, or to the right, or below."""
        self.line([(x, self.y_range[0]), (x, self.y_range[1])], style)
        at, _ = self.place(x, self.y_range[1])
        anchor, y = ("start", self._frame[3] - 4) if low else ("end", _TOP + 2)
        template = '<text class="along" transform="translate({} {}) rotate(-90)" text-anchor="{}">{}</text>'
        self._add(template, at + (13.0 if right else -4.0), y, anchor, text)

    def svg(self) -> Markup:
        """Return the finished drawing."""
        content = Markup("").join([*self._x_axis(), *self._y_axis(), *self._shapes])
        letter = self.width * _LETTER_SHARE if self.is_wide else None
        return drawing(self.title, self.description, self.width, self.height, content, letter=letter)

    def _x_axis(self) -> Iterator[Markup]:
        left, top, right, bottom = self._frame
        ticks = self.x_ticks or _ticks(self.x_range, (right - left) / _TICK_ROOM[0], logarithmic=self.log_x)
        larger = self.width * _LETTER_SHARE / _LETTER if self.is_wide else 1.0
        free_from = free_on_telephone = 0.0
        for value in ticks:
            x, _ = self.place(value, self.y_range[0])
            yield shape('<path class="grid" d="M{} {}V{}"/>', x, top, bottom)
            label = f"{value:g}"
            half = _DIGIT / 2.0 * len(label)
            inside = min(x, self.width - half)  # so that a long number at the right end is not cut
            if inside - half < free_from:  # so that numbers do not overlap
                continue
            free_from, half = inside + half, half * larger
            fits = inside - half >= free_on_telephone and inside + half <= self.width + _OUTSIDE
            free_on_telephone = inside + half + _DIGIT / 2.0 * larger if fits else free_on_telephone
            text = '<text x="{}" y="{}" text-anchor="middle"{}>{}</text>'
            yield shape(text, inside, bottom + 17.0, Markup("" if fits else ' class="roomy"'), label)
        if self.x_label:
            place = (left + right) / 2, self.height - 6
            yield shape('<text class="axis" x="{}" y="{}" text-anchor="middle">{}</text>', *place, self.x_label)

    def _y_axis(self) -> Iterator[Markup]:
        left, top, right, bottom = self._frame
        for value in _ticks(self.y_range, (bottom - top) / _TICK_ROOM[1], logarithmic=self.log_y):
            _, y = self.place(self.x_range[0], value)
            yield shape('<path class="grid" d="M{} {}H{}"/>', left, y, right)
            yield shape('<text x="{}" y="{}" text-anchor="end">{}</text>', left - 6, y + 4, f"{value:g}")
        if self.y_label:
            upright = '<text class="axis" transform="translate(13 {}) rotate(-90)" text-anchor="middle">{}</text>'
            yield shape(upright, (top + bottom) / 2, self.y_label)

    def _add(self, template: str, *values: object) -> None:
        self._shapes.append(shape(template, *values))


def drawing(
    title: str, description: str, width: float, height: float, content: Markup, *, letter: float | None = None
) -> Markup:
    """Return an SVG element with a description in words; `letter` is the size of its letters on a telephone."""
    wide = Markup("" if letter is None else '; --letter: {:.1f}px" class="wide').format(letter)
    return Markup(
        '<svg viewBox="0 0 {:g} {:g}" style="max-width: {:.0f}px{}" role="img"><title>{}</title><desc>{}</desc>{}</svg>'
    ).format(width, height, _LARGEST * width, wide, legible(title), legible(description), content)


def _ticks(ends: Point, room_for: float, *, logarithmic: bool) -> tuple[float, ...]:
    """Return as many ticks of an axis as there is room for, and at least two."""
    if logarithmic:
        return log_ticks(*ends)
    candidates = (nice_ticks(*ends, about=about) for about in count(max(_FEWEST_TICKS, int(room_for))))
    return next(ticks for ticks in candidates if len(ticks) > 1)


def _share(value: float, ends: Point, *, logarithmic: bool) -> float:
    """Return the position of a value between two ends, 0 to 1."""
    low, high = ends
    if logarithmic:
        low, high, value = math.log10(low), math.log10(high), math.log10(value)
    return (value - low) / (high - low)
