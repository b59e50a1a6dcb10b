"""Cycles of the calls of functions in running firmware, without instrumentation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hiltest.errors import ConfigError
from hiltest.virtual.calls.calling import find_function
from hiltest.virtual.processor.call_summary import Call, CallSummary, summarise_calls
from hiltest.virtual.processor.cpu import Processor

_COLD = ".cold"  # suffix of the rarely executed part of a function, which the compiler moves away


class CallWatch:
    """Counter of the calls of some functions, see `VirtualCortexM4.watch_calls`.

    Parameters
    ----------
    processor
        Processor that is not running.

    Attributes
    ----------
    running : RunningCalls
        Recorder of the processor's calls.
    functions : dict of str to WatchedFunction
        Watched functions by name.
    began : int
        Cycle of the latest `begin`.

    Raises
    ------
    ConfigError
        If a function does not exist.
    """

    def __init__(self, processor: Processor, functions: Iterable[str]) -> None:
        self._image = processor.image
        self.running = processor.calls
        symbols = [find_function(self._image, name) for name in functions]
        self.functions = {symbol.name: self.running.watch(symbol.address) for symbol in symbols}
        self.begin()

    def begin(self) -> None:
        """Ignore calls that began before now."""
        self.running.fetch()
        self.began = self.running.now()
        self._before = {
            name: (len(function.calls), function.abandoned, function.came_back)
            for name, function in self.functions.items()
        }

    def record_word(self, address: int, size: int) -> None:
        """Record a word of memory in `Call.word` at each return.

        Raises
        ------
        ConfigError
            If another word is already recorded.
        """
        for name, function in self.functions.items():
            if function.recorded_word not in (None, (address, size)):
                raise ConfigError(f"{name} is already watched with another word; only one word can end its solutions")
            function.record_word(address, size)

    @property
    def cycles(self) -> int:
        """Cycles since `begin`, including sleep."""
        return self.running.now() - self.began

    def calls(self, function: str) -> Sequence[Call]:
        """Return the calls of a function that began and returned since `begin`, in the order of their returns."""
        self.running.fetch()
        first, _, _ = self._before[function]
        return [call for call in self.functions[function].calls[first:] if call.entered >= self.began]

    def stack(self, function: str) -> int | None:
        """Return the largest stack use of a call [bytes]; None if the use of any call is unknown."""
        self.running.fetch()
        sizes = [call.stack for call in self.functions[function].calls]
        known_sizes = [size for size in sizes if size is not None]
        return max(known_sizes) if known_sizes and len(known_sizes) == len(sizes) else None

    def summary(self, function: str) -> CallSummary:
        """Return the statistics of a function's calls since `begin`."""
        calls = self.calls(function)
        watched, (_, abandoned, came_back) = self.functions[function], self._before[function]
        return summarise_calls(
            function,
            calls,
            self.cycles,
            abandoned=watched.abandoned - abandoned,
            open_calls=watched.open,
            came_back=watched.came_back - came_back,
            lost=watched.lost,
            ended_in=self._ended_in(function, calls),
        )

    def _ended_in(self, function: str, calls: Sequence[Call]) -> tuple[str, ...]:
        """Return the other functions that returned in place of a function."""
        own = self.functions[function].address
        symbols = {self._image.function_at(place) for place in {call.ended_in for call in calls}}
        names = {symbol.name for symbol in symbols if symbol is not None and symbol.address != own}
        return tuple(sorted(name for name in names if name.partition(_COLD)[0] != function))
