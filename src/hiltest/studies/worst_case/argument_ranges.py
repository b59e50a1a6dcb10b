"""Arguments of a function with ranges of numbers: ``LOW..HIGH``, or ``TYPE:COUNT:LOW..HIGH`` for an array.

Other arguments are as in `hiltest.virtual.profiling.arguments`. An input is the arguments with numbers in place of the
ranges, so that ``hiltest profile`` accepts the result unchanged.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.errors import BoardFault, ConfigError
from hiltest.studies.worst_case.search import Call
from hiltest.virtual.board.k64f import board_for
from hiltest.virtual.calls.calling import find_function
from hiltest.virtual.profiling.arguments import parse_argument

_NUMBER = r"[-+]?(?:0[xX][0-9a-fA-F]+|[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?)"
_RANGE = re.compile(
    rf"(?:(?P<type>(?:u?int(?:8|16|32|64)|float(?:32|64))):(?P<count>[0-9]+):)?(?P<low>{_NUMBER})\.\.(?P<high>{_NUMBER})"
)
_FILE = re.compile(r"(?:^|[:+])@")
_MOST_NUMBERS = 100_000  # more than fit into the RAM
_LARGEST = 1 << 53  # below this, doubles can represent all integers


@dataclass(frozen=True, slots=True)
class Range:
    """Range of a number, or of the numbers of an array."""

    low: float
    high: float
    is_whole: bool
    """True if both ends are integers and the type is not a float; the numbers are then integers."""
    is_single: bool = False
    """True if the type is float32."""

    @classmethod
    def from_match(cls, match: re.Match[str]) -> Range:
        """Return the range in a match of its pattern.

        Raises
        ------
        ConfigError
            If the ends are not in order, or the type cannot represent them.
        """
        low, high = (_number(match[end]) for end in ("low", "high"))
        kind = match["type"] or ""
        is_whole = isinstance(low, int) and isinstance(high, int) and not kind.startswith("float")
        if not low < high:
            raise ConfigError(f"{match[0]!r}: write LOW..HIGH, with LOW less than HIGH")
        if not (math.isfinite(high - low) and max(abs(low), abs(high)) < _LARGEST) and is_whole:
            raise ConfigError(f"{match[0]!r}: whole numbers must be below 2**53")
        if "int" in kind:
            limits = np.iinfo(kind)
            if not is_whole or low < limits.min or high > limits.max:
                raise ConfigError(f"{match[0]!r}: {kind} has whole numbers from {limits.min} to {limits.max}")
        return cls(low, high, is_whole, kind == "float32")

    def text(self, number: float) -> str:
        """Return a number of this range as the text of an argument."""
        if self.is_whole:
            return str(round(min(max(number, self.low), self.high)))
        single = float(np.float32(number)) if self.is_single else float(number)
        return repr(min(max(single, self.low), self.high))


def parse_range(text: str) -> Range:
    """Read a range, or a number as both ends of a range.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    if (match := _RANGE.fullmatch(text)) and not match["type"]:
        return Range.from_match(match)
    if re.fullmatch(_NUMBER, text):
        return Range(_number(text), _number(text), is_whole=False)
    raise ConfigError(f"{text!r}: write LOW..HIGH, or one number")


def _number(text: str) -> int | float:
    try:
        return int(text, 0)
    except ValueError:
        return float(text)


class ArgumentRanges:
    """The inputs of a function of an ELF, within ranges of its arguments.

    Parameters
    ----------
    returns
        Range of return values that mean success; by default any.

    Raises
    ------
    ConfigError
        If there is no such function, an argument is invalid, or no argument has a range.
    """

    def __init__(self, elf: Path, function: str, texts: Sequence[str], returns: Range | None) -> None:
        self._board = board_for(elf)
        self._function, self._returns = find_function(self._board.image, function).name, returns
        self._pieces: list[list[str | Range]] = [_pieces(text) for text in texts]
        self._ranges = [piece for pieces in self._pieces for piece in pieces if isinstance(piece, Range)]
        if not self._ranges:
            raise ConfigError(
                f"{function}: no argument has a range; write LOW..HIGH for a number, or int16:100:LOW..HIGH for an "
                "array of a hundred numbers"
            )
        if len(self._ranges) > _MOST_NUMBERS:
            raise ConfigError(f"{function}: {len(self._ranges)} numbers do not fit into the RAM")
        self.bounds = np.array([(range_.low, range_.high) for range_ in self._ranges], dtype=np.float64)

    def make_input(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the numbers, which are the input."""
        return numbers.copy()

    def vary(self, base: NDArray[np.float64], random: np.random.Generator) -> NDArray[np.float64]:
        """Change some numbers: by a step, to a random value, to an end of the range, or to another number's value."""
        low, high = self.bounds.T
        numbers = base.copy()
        for k in random.integers(len(base), size=round(len(base) ** random.random())):
            width, choice = high[k] - low[k], random.random()
            if choice < 0.6:
                step = width * 10.0 ** random.uniform(-6.0, 0.0) * random.standard_normal()
                numbers[k] += math.copysign(max(abs(step), 1.0), step) if self._ranges[k].is_whole else step
            elif choice < 0.8:
                numbers[k] = random.uniform(low[k], high[k])
            elif choice < 0.9:
                numbers[k] = low[k] if random.random() < 0.5 else high[k]
            else:
                numbers[k] = numbers[random.integers(len(base))]
        return np.clip(numbers, low, high)

    def saved_fields(self, numbers: NDArray[np.float64]) -> dict[str, tuple[str, ...]]:
        """Return the arguments as fields of a `WorstCase`."""
        return {"arguments": self._texts(numbers)}

    def _texts(self, values: NDArray[np.float64]) -> tuple[str, ...]:
        numbers = iter(values)
        return tuple(
            "".join(piece.text(float(next(numbers))) if isinstance(piece, Range) else piece for piece in pieces)
            for pieces in self._pieces
        )

    def call(self, numbers: NDArray[np.float64]) -> Call:
        """Call the function; only successful calls count.

        Raises
        ------
        BoardFault
            If the function faults or hangs; the message has the arguments.
        """
        texts = self._texts(numbers)
        try:
            result = self._board.call(self._function, *map(parse_argument, texts))
        except BoardFault as fault:
            raise BoardFault(
                f"{fault.cause} ({self._function} was called with {' '.join(texts)})",
                pc=fault.pc,
                function=fault.function,
                location=fault.location,
                registers=fault.registers,
                ending=fault.ending,
            ) from fault
        returns, value = self._returns, result.value
        counts = returns is None or (value is not None and returns.low <= value <= returns.high)
        return Call(result.cycles, value, counts)


def refuse_files(texts: Sequence[str]) -> None:
    """Reject arguments with the content of files, because a saved case would be incomplete."""
    for text in texts:
        if not text.startswith("text:") and _FILE.search(text):
            raise ConfigError(f"{text!r}: the content of a file cannot be saved with the arguments; write its numbers")


def _pieces(text: str) -> list[str | Range]:
    """Split an argument at its ranges."""
    refuse_files([text])
    if text.startswith("text:"):
        return [text]
    pieces: list[str | Range] = []
    end = 0
    for match in _RANGE.finditer(text):
        pieces.append(text[end : match.start()])
        end = match.end()
        part = Range.from_match(match)
        if not match["type"]:
            pieces.append(part)
            continue
        count = int(match["count"]) if len(match["count"]) < 7 else 0
        if not 1 <= count <= _MOST_NUMBERS:
            raise ConfigError(f"{match[0]!r}: write at least one number, and not more than fit into the RAM")
        pieces.append(f"{match['type']}:")
        for k in range(count):
            pieces += [part] if k == 0 else [",", part]
    return [*pieces, text[end:]]
