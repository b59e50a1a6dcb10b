"""Part files: the memories of a chip, its clocks, and what they add to the cycles of instructions.

A part file (``parts/*.toml``) is a timing profile (`hiltest.virtual.model.profile_file`) with a table ``[part]``.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationError

from hiltest.budgets import PART
from hiltest.errors import ConfigError
from hiltest.json_files import adapter, describe_invalid, read_bounded
from hiltest.virtual.model.profile_file import SUFFIX, parse_rows, read_tables
from hiltest.virtual.model.timing import CostRow, CountError, TimingProfile, WaitingMemories
from hiltest.virtual.part.chip import MemoryMap, Region

_MEGA = 1_000_000
_Text = Annotated[str, Field(min_length=1, max_length=500)]


class ClosedTable:
    """Base of tables without unknown keys."""

    __slots__ = ()
    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}


@dataclass(frozen=True, slots=True)
class PartMemory(ClosedTable):
    """One memory of a part; `late` marks RAM that answers late (row ``late_access``)."""

    name: Annotated[str, Field(pattern="^[a-z0-9_]{1,16}$")]
    kind: Literal["flash", "ram"]
    begin: Annotated[int, Field(ge=0, lt=1 << 32, multiple_of=1024)]
    kib: Annotated[int, Field(ge=1, le=1 << 16)]
    late: bool = False

    @property
    def region(self) -> Region:
        return self.begin, self.kib << 10


@dataclass(frozen=True, slots=True)
class WaitStates(ClosedTable):
    """Highest core clocks of the flash [MHz], with no wait state, with one, and so on."""

    up_to_mhz: Annotated[list[Annotated[float, Field(gt=0, le=1000)]], Field(min_length=1, max_length=16)]
    source: _Text


@dataclass(frozen=True, slots=True)
class _PartTable(ClosedTable):
    title: _Text
    memories: Annotated[list[PartMemory], Field(max_length=16)]
    core: Literal["cortex-m0", "cortex-m0plus", "cortex-m3", "cortex-m4", "cortex-m33"] = "cortex-m4"
    clock_mhz: Annotated[float, Field(gt=0, le=1000)] = 120
    wait_states: WaitStates | None = None


@dataclass(frozen=True, slots=True)
class Part:
    """A chip.

    Attributes
    ----------
    name : str
        Name and version of its numbers, such as ``stm32f407/1``.
    title : str
        Chips that it describes.
    memories : list of PartMemory
        Empty for a core with any memories, none of which waits.
    clock_hz : int
        Highest core clock [Hz].
    core : str
        Name of its core, such as ``cortex-m4``.
    file : Path
        File that describes it.
    """

    name: str
    title: str
    memories: list[PartMemory]
    clock_hz: int
    core: str
    file: Path
    _wait_states: WaitStates | None
    _rows: dict[str, CostRow]
    _memory_rows: dict[str, CostRow]
    _errors: dict[str, CountError]
    _shipped: bool

    @property
    def memory_map(self) -> MemoryMap | None:
        """Its memories, with adjacent ones joined; None if images state their own."""
        if not self.memories:
            return None
        flash, ram = (_joined(memory for memory in self.memories if memory.kind == kind) for kind in ("flash", "ram"))
        return MemoryMap(flash, ram)

    @property
    def counts_system_bus(self) -> bool:
        """Return whether its rows price the waits of code in RAM from 0x20000000 for the system bus."""
        return bool({"system_fetch", "upper_single"} & self._memory_rows.keys())

    def timing(self, clock_hz: float | None = None) -> TimingProfile:
        """Return the timing profile at a core clock [Hz], by default the highest one.

        Raises
        ------
        ConfigError
            If the part does not run at this clock.
        """
        name, memory, errors = self.name, self._memory_rows, dict(self._errors)
        waiting_error = errors.pop("flash_waiting", None)
        if self._wait_states is not None:
            states = self._number_of_wait_states(self.clock_hz if clock_hz is None else clock_hz)
            clocks, source = states + 1, self._wait_states.source
            name = f"{name}-{states}ws"
            if states:
                errors.pop("flash", None)
                errors |= {"flash": waiting_error} if waiting_error else {}
            memory = memory | {"flash_clocks": CostRow(clocks, (clocks, clocks), source)}
        waiting = None
        if memory and self.memories:
            flash = next((entry.region for entry in self.memories if entry.kind == "flash"), (0, 0))
            late = tuple(entry.region for entry in self.memories if entry.late)
            waiting = WaitingMemories(flash, late, tuple(entry.begin for entry in self.memories))
        return TimingProfile(
            name,
            self._rows,
            memory,
            waiting=waiting,
            errors=errors,
            waits_for_flash=bool(memory or self.memories),
            shipped=self._shipped,
        )

    def _number_of_wait_states(self, clock_hz: float) -> int:
        assert self._wait_states is not None
        for states, mhz in enumerate(self._wait_states.up_to_mhz):
            if clock_hz <= mhz * _MEGA:
                return states
        highest = self._wait_states.up_to_mhz[-1]
        raise ConfigError(f"{self.name} runs at up to {highest:g} MHz, not {clock_hz / _MEGA:g} MHz; lower --clock")


def _joined(memories: Iterable[PartMemory]) -> tuple[Region, ...]:
    regions: list[Region] = []
    for begin, size in sorted(memory.region for memory in memories):
        if regions and sum(regions[-1]) == begin:
            before, length = regions.pop()
            begin, size = before, length + size
        regions.append((begin, size))
    return tuple(regions)


@cache
def shipped_parts() -> dict[str, Path]:
    """Return the shipped parts: name, with its version, and file."""
    folder = Path(str(resources.files("hiltest.virtual.part"))) / "parts"
    files = sorted(folder.glob(f"*{SUFFIX}"))
    return {read_tables(str(file), file.read_bytes())["name"]: file for file in files}


def load_part(name: str) -> Part:
    """Return a part.

    Parameters
    ----------
    name
        A shipped part, such as ``stm32f407`` for its latest numbers or ``stm32f407/1``, or a file (``.toml``).

    Raises
    ------
    ConfigError
        If there is no such part, or the file is not a part file; the message names the place and a remedy.
    """
    if name.endswith(SUFFIX):
        return _read_part(Path(name), shipped=False)
    versions = {full: file for full, file in shipped_parts().items() if name in (full, full.partition("/")[0])}
    if not versions:
        names = ", ".join(sorted({full.partition("/")[0] for full in shipped_parts()}))
        raise ConfigError(f"no part {name!r}; known: {names}; the name of your own file ends in {SUFFIX}")
    latest = max(versions, key=lambda full: int(full.partition("/")[2]))
    return _read_part(versions[latest], shipped=True)


def _read_part(file: Path, *, shipped: bool) -> Part:
    place, tables = str(file), _tables_of(file)
    described: Any = tables.pop("part", None)
    if described is None:
        raise ConfigError(f"{place}: there is no table [part]; start from a copy of a shipped part file")
    try:
        table = adapter(_PartTable).validate_python(described)
    except ValidationError as error:
        raise ConfigError(f"{place}: part.{describe_invalid(error.errors()[0])}") from error
    name, rows, memory, errors = parse_rows(place, tables, is_part=True)
    clock_hz = round(table.clock_mhz * _MEGA)
    part = Part(
        name,
        table.title,
        table.memories,
        clock_hz,
        table.core,
        file,
        table.wait_states,
        rows,
        memory,
        errors,
        shipped,
    )
    _check_memories(place, part)
    return part


def _tables_of(file: Path) -> dict[str, Any]:
    """Return the content of a part file, with the costs of the shipped part that it names as its base, if it does."""
    tables = read_tables(str(file), read_bounded(file, PART, otherwise="name a part file (TOML)"), PART)
    base, cost = tables.get("base"), tables.get("cost", {})
    if isinstance(base, str) and isinstance(cost, dict) and base in shipped_parts():
        based_on = _tables_of(shipped_parts()[base])
        tables |= {"base": based_on["base"], "cost": based_on.get("cost", {}) | cost}
    return tables


def _check_memories(place: str, part: Part) -> None:
    if part.memories and not any(memory.kind == "ram" for memory in part.memories):
        raise ConfigError(f"{place}: part.memories: there is no RAM for arguments and stack; add one of kind ram")
    ordered = sorted(part.memories, key=lambda memory: memory.begin)
    for memory, following in itertools.pairwise(ordered):
        if sum(memory.region) > following.begin:
            raise ConfigError(f"{place}: part.memories: {memory.name} and {following.name} overlap")
