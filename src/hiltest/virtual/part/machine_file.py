"""Machine files: a board with its chip, as data (``machines/*.toml``)."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from hiltest.budgets import MACHINE
from hiltest.errors import ConfigError
from hiltest.json_files import adapter, describe_invalid, read_bounded
from hiltest.virtual.model.profile_file import read_tables
from hiltest.virtual.part.chip import Chip, ChipPeripheral, ChipRegister, MemoryMap
from hiltest.virtual.part.part_file import ClosedTable

_BLOCK_BYTES = 0x400
_FOLDER = Path(str(resources.files("hiltest.virtual.part"))) / "machines"
_Address = Annotated[int, Field(ge=0, lt=1 << 32)]


@dataclass(frozen=True, slots=True)
class _Memory(ClosedTable):
    kind: Literal["flash", "ram"]
    begin: Annotated[int, Field(ge=0, lt=1 << 32, multiple_of=4096)]
    kib: Annotated[int, Field(ge=4, le=1 << 16)]
    alias: _Address | None = None
    sectors_kib: list[Literal[16, 64, 128]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Words(ClosedTable):
    address: _Address
    values: list[_Address]


@dataclass(frozen=True, slots=True)
class Block(ClosedTable):
    """A block of registers of 1 KiB.

    Attributes
    ----------
    registers : str
        Name of the list of its registers, which also selects its model; empty for a block without a model.
    gate : str
        Register and bit of RCC that enables its clock, such as ``APB1ENR.17``; empty if its clock always runs.
    requests : dict of str to str
        Requests that it serves as a DMA controller, such as ``USART2_TX``, with streams and channels such as ``6.4``.
    """

    base: Annotated[int, Field(ge=0, lt=1 << 32, multiple_of=_BLOCK_BYTES)]
    registers: str = ""
    gate: Annotated[str, Field(pattern=r"^([A-Z0-9]+\.\d{1,2})?$")] = ""
    interrupts: list[int] = field(default_factory=list)
    bits: Literal[16, 32] = 16
    reset: dict[str, _Address] = field(default_factory=dict)
    requests: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BoardTable(ClosedTable):
    """The board around the chip: its crystal [MHz], serial port, and LEDs and buttons by pin, all active high."""

    hse_mhz: Annotated[float, Field(gt=0, le=50)]
    serial: str
    leds: dict[str, str]
    buttons: dict[str, str]


@dataclass(frozen=True, slots=True)
class MachineFile(ClosedTable):
    """A board with its chip."""

    title: str
    core: Literal["cortex-m3", "cortex-m4"]
    part: str
    """Name of the part, whose price list counts the cycles."""
    interrupts: Annotated[int, Field(ge=1, le=240)]
    memories: list[_Memory]
    board: BoardTable
    registers: dict[str, str]
    """Names of the words of a block from its first address on; a minus stands for a word without a register."""
    blocks: dict[str, Block]
    words: list[_Words] = field(default_factory=list)
    """Words that the factory has programmed."""

    @property
    def memory_map(self) -> MemoryMap:
        """Memories, and the addresses at which they are seen, too."""
        regions = [(memory, (memory.begin, memory.kib << 10)) for memory in self.memories]
        flash, ram = (tuple(region for memory, region in regions if memory.kind == kind) for kind in ("flash", "ram"))
        return MemoryMap(
            flash, ram, tuple((memory.alias, region) for memory, region in regions if memory.alias is not None)
        )

    def chip(self) -> Chip:
        """Return the blocks with the names of their registers."""
        return Chip(tuple(self._peripheral(name, block) for name, block in self.blocks.items()), ())

    def sources(self, name: str) -> dict[str, int]:
        """Return the numbers of the requests that a DMA controller serves, by stream and channel."""
        numbers = self._request_numbers
        requests = self.blocks[name].requests.items()
        return {place: numbers[request] for request, places in requests for place in places.split()}

    @property
    def _request_numbers(self) -> dict[str, int]:
        names = (request for block in self.blocks.values() for request in block.requests)
        return {request: number for number, request in enumerate(names)}

    def _peripheral(self, name: str, block: Block) -> ChipPeripheral:
        words = enumerate(self.registers.get(block.registers, "").split())
        registers = tuple(
            ChipRegister(f"{name}_{word}", block.base + 4 * number, 4, block.reset.get(word, 0))
            for number, word in words
            if word != "-"
        )
        numbers = self._request_numbers
        requests = tuple(numbers[f"{name}_{end}"] for end in ("RX", "TX") if f"{name}_{end}" in numbers)
        return ChipPeripheral(name, block.base, _BLOCK_BYTES, (), registers, tuple(block.interrupts), requests)


def _shipped() -> list[str]:
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def load_machine(name: str) -> MachineFile:
    """Return a machine: a shipped one such as ``stm32f411-disco``, or a file that ends in ``.toml``.

    Raises
    ------
    ConfigError
        If there is no such machine, or the file is invalid.
    """
    file = Path(name) if name.endswith(".toml") else _FOLDER / f"{name}.toml"
    if not name.endswith(".toml") and not file.is_file():
        names = ", ".join(["frdm-k64f", "microbit-v1", *_shipped()])
        raise ConfigError(f"no machine {name!r}; known: {names}; the name of your own file ends in .toml")
    try:
        machine: MachineFile = adapter(MachineFile).validate_python(_tables(file))
    except ValidationError as error:
        raise ConfigError(f"{file}: {describe_invalid(error.errors()[0])}") from error
    return machine


def _tables(file: Path) -> dict[str, Any]:
    """Return the content of a file, with that of the machine that it is like; its blocks are added or replaced."""
    content = read_bounded(file, MACHINE, otherwise="name a machine file (TOML)")
    tables = read_tables(str(file), content, MACHINE)
    other, absent = tables.pop("like", None), tables.pop("without", [])
    if other is None:
        return tables
    base = _FOLDER / f"{other}.toml"
    if base == file or base.name != f"{other}.toml" or not base.is_file():
        raise ConfigError(f"{file}: like: no machine {other!r} comes with hiltest; known: {', '.join(_shipped())}")
    described = _tables(base)
    blocks = {name: block for name, block in described["blocks"].items() if name not in absent}
    merged = {key: {**described.get(key, {}), **tables.get(key, {})} for key in ("registers", "board")}
    return {**described, **tables, **merged, "blocks": {**blocks, **tables.get("blocks", {})}}
