"""Reader of timing profiles, which are shipped with the package or written by users."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from hiltest.budgets import PROFILE, Budget, BudgetError
from hiltest.errors import ConfigError, UnknownKeyError
from hiltest.json_files import parse_toml, read_bounded, shown
from hiltest.virtual.model.timing import CostRow, CountError, TimingProfile

DEFAULT_PROFILE = "cortex-m4-trm/3"
#: Profile with the memories of the K64F, and the default profile's instructions.
MEMORY_PROFILE = "cortex-m4-k64f/3"
SUFFIX = ".toml"

#: Rows of every profile, and the instructions that each row prices.
ROWS = {
    "data": "moves, arithmetic, logic, shifts, saturation, SIMD, multiplies, long and accumulating ones too",
    "divide": "SDIV, UDIV",
    "load": "LDR and narrower",
    "load_behind_load": "a load right after a load that does not compute its address",
    "store": "STR and narrower, immediate offset",
    "store_register_offset": "STR and narrower, register offset",
    "store_behind_load": "an immediate-offset store right after a load",
    "load_behind_store": "added to a load right after a store",
    "multiple_base": "LDM, STM, PUSH, POP, LDRD, STRD, VLDM, VSTM: in addition to 1 per word",
    "branch": "the branch itself, taken or not",
    "refill_direct": "added when a branch to a fixed target is taken",
    "refill_indirect": "added when the target comes from a register or memory",
    "table_branch": "TBB, TBH, before the refill",
    "it": "IT",
    "barrier": "DMB, DSB, ISB",
    "system": "MRS, MSR, CPS, SVC, WFI, SEV, NOP",
    "exclusive": "LDREX, STREX and narrower",
    "fp": "VADD, VSUB, VMUL, VNMUL, VNEG, VABS, VCMP, VCVT, VMOV, VMRS, VMSR",
    "fp_use": "added when the next instruction uses a floating-point result",
    "fp_accumulate": "VMLA, VMLS, VFMA, VFMS and their negations",
    "fp_accumulate_hidden": "part of fp_accumulate that overlaps integer instructions",
    "fp_divide": "time for which VDIV or VSQRT occupies the FPU",
    "fp_divide_use": "time from VDIV or VSQRT until its result can be used",
    "fp_load": "VLDR",
    "fp_store": "VSTR",
    "fp_move_pair": "VMOV between two core registers and two single ones",
    "exception_entry": "exception entry",
    "exception_return": "exception return",
}
#: Optional rows of a profile, and their meaning; without a row its rule does not apply.
RULES = {
    "load_same_base": "1 if two successive loads that move the same base register do not overlap",
    "multiple_behind_store": "added to LDM, LDRD, VLDM after a single store",
    "address_use": "added when an address depends on the result of the data-processing instruction right before",
    "address_use_fp": "the same after VMOV from the FPU to a core register",
    "it_folded": "IT after an instruction of two bytes",
    "it_skipped": "an instruction that an IT block skips; without this row it costs as much as if executed",
    "target_misplaced": "added when the target of a taken branch is a misaligned instruction of four bytes",
    "return_misplaced": "the same when the target comes from a register or memory",
    "refill_table": "instead of refill_indirect: TBB, TBH",
    "refill_load": "instead of refill_indirect: LDR to the PC",
    "refill_multiple": "instead of refill_indirect: LDM, POP to the PC",
    "refill_call": "instead of refill_direct: BL",
    "multiply": "instead of data: MUL",
    "multiply_accumulate": "instead of data: MLA, MLS",
    "multiply_long": "instead of data: UMULL, SMULL",
    "accumulate_long": "instead of data: UMLAL, SMLAL, UMAAL",
    "fetch_late": "added to the third of three misaligned instructions of four bytes after one of two cycles",
    "fetch_late_fp": "the same after a floating-point instruction of one cycle",
    "fetch_late_integer": "the same after an integer instruction of one cycle",
    "fetch_late_access": "the same after a load or store of one cycle",
    "fetch_late_unbroken": "1 if such a run goes on past an instruction of two cycles, instead of beginning anew",
    "tail_chain": "instead of a return and an entry, when an exception is pending as a handler ends",
    "fp_frame": "added when a frame's floating-point registers are saved, at once or lazily, and when restored",
    "unaligned": "added for each part but the first of an unaligned access",
    "load_other_block": "added to a load or store that would overlap a load in another block of memory",
    "doubt_permille": "uncertainty of any count that no row explains, in thousandths of the count",
}
#: Rows of the memories, and their meaning.
MEMORY_ROWS = {
    "flash_clocks": "core clocks of one clock of the flash",
    "flash_line_bytes": "bytes of one read of the flash",
    "flash_read_ahead": "1 if the next line is prefetched at once",
    "cache_entry_bytes": "bytes of an entry of the flash cache",
    "cache_ways": "ways of the flash cache",
    "cache_sets": "sets of the flash cache",
    "lower_single": "hundredths of a clock: LDR, STR, code and data in SRAM_L",
    "lower_multiple": "hundredths of a clock: LDM, STM, code and data in SRAM_L",
    "upper_single": "hundredths of a clock: LDR, STR, code and data in SRAM_U",
    "upper_multiple": "hundredths of a clock: LDM, STM, code and data in SRAM_U",
    "flash_lower_single": "hundredths of a clock: LDR, STR, code in flash, data in SRAM_L",
    "flash_lower_multiple": "hundredths of a clock: LDM, STM, code in flash, data in SRAM_L",
    "flash_uncertainty": "uncertainty of a count of code in flash, in percent of the count",
}
#: Optional rows of the memories.
MEMORY_RULES = {
    "unaligned": "added for each part but the first of an unaligned access",
    "flash_synchronous": "1 if the flash has the core's clock: of flash_clocks the first is the fetch's own",
    "flash_load": "hundredths of a clock: an access of one word of code in flash to data in flash",
    "system_fetch": "clocks for which a fetched word occupies the system bus, over which code from 0x20000000 comes",
    "late_access": "added once to successive accesses to a RAM that answers late; the store buffer hides a lone store",
}
#: Least value of rows, if it is more than 0. A branch to itself must take time, or it would never reach the event that
#: ends it; a read of the flash returns whole words.
AT_LEAST = {
    "branch": 1,
    "fp_accumulate": 1,
    "fp_divide": 1,
    "flash_clocks": 1,
    "flash_line_bytes": 4,
    "cache_entry_bytes": 4,
    "cache_ways": 1,
    "cache_sets": 1,
}
_MOST_CYCLES = 1000  # far more than any instruction takes, while sums stay within 32 bits
_AT_MOST = {  # as core/waits.h
    "flash_read_ahead": 1,
    "flash_synchronous": 1,
    "flash_uncertainty": 100,
    "cache_ways": 16,
    "cache_sets": 64,
}
_POWERS_OF_TWO = frozenset({"flash_line_bytes", "cache_entry_bytes", "cache_sets"})  # addresses are divided by them
_MOST_PERMILLE = 500  # a wider range says nothing
_TABLES = ("name", "base", "memory_base", "cost", "memory", "error", "board", "measured")  # the last two price nothing
#: Memories of code for which a profile may state the errors of counts: RAM on the code buses and on the system bus,
#: flash without wait states and with them.
ERROR_PLACES = ("sram", "sram_u", "flash", "flash_waiting")
_KEYS = ("value", "band", "source", "against")
_NAME = re.compile(r"[a-z0-9][a-z0-9./-]{0,63}")
#: A profile that has all rows of a table.
_WITH_ROWS = {"cost": DEFAULT_PROFILE, "memory": MEMORY_PROFILE}


def _advice(table: str = "cost") -> str:
    return (
        f'write base = "{_WITH_ROWS[table]}" below its name, and only the rows that differ; or start from a copy of a '
        "shipped profile: `hiltest timing show` prints its file"
    )


@cache
def shipped_profiles() -> dict[str, Path]:
    """Return the shipped profiles: name and file."""
    folder = Path(str(resources.files("hiltest.virtual.model"))) / "profiles"
    files = sorted([*folder.glob(f"*{SUFFIX}"), *folder.glob(f"silicon/*{SUFFIX}")])
    return {tomllib.loads(file.read_text(encoding="utf-8"))["name"]: file for file in files}


def load_profile(name: str) -> TimingProfile:
    """Return a timing profile.

    Parameters
    ----------
    name
        Name of a shipped profile, or a user's own file (``.toml``).

    Raises
    ------
    ConfigError
        If there is no such profile, or the file is not a timing profile; the message names the place and a remedy.
    """
    file = place_of(name)
    content = read_bounded(file, PROFILE, otherwise="name a timing profile (TOML)")
    return _profile_of(str(file), content, shipped=file in shipped_profiles().values())


def measured_file(file: Path) -> tuple[dict[str, Any], str, dict[str, CostRow]]:
    """Read the file of a measured profile.

    Returns
    -------
    content : dict
        Content of the file; ``board`` and ``measured`` are unchecked.
    name : str
    rows : dict of str to CostRow

    Raises
    ------
    ConfigError
        If the file is not a timing profile.
    """
    content = read_bounded(file, PROFILE, otherwise="name a timing profile (TOML)")
    name, rows, *_ = _parse(str(file), content)
    return tomllib.loads(content.decode("utf-8")), name, rows


def place_of(name: str) -> Path:
    """Return the file of a profile; the file of a user's own profile may be missing.

    Raises
    ------
    ConfigError
        If the name is neither a shipped profile nor a file.
    """
    if name.endswith(SUFFIX):
        return Path(name)
    file = shipped_profiles().get(name)
    if file is None:
        names = ", ".join(shipped_profiles())
        raise ConfigError(f"no timing profile {name!r}; known: {names}; the name of your own file ends in {SUFFIX}")
    return file


@cache
def _profile_of(place: str, content: bytes, *, shipped: bool) -> TimingProfile:
    # Caches of prices are keyed by the object, so the same content must give the same object.
    name, rows, memory, errors = _parse(place, content)
    return TimingProfile(name, rows, memory, errors=errors, shipped=shipped)


def read_tables(place: str, content: bytes, budget: Budget = PROFILE) -> dict[str, Any]:
    """Return the content of a TOML file; its tables are unchecked.

    Raises
    ------
    ConfigError
        If it is over its budget, or not TOML.
    """
    try:
        return parse_toml(content, budget)
    except UnicodeDecodeError as error:
        raise ConfigError(f"{place}: not UTF-8 text at byte {error.start}; {_advice()}") from error
    except BudgetError as error:
        raise ConfigError(f"{place}: {error}; {_advice()}") from error
    except ValueError as error:
        raise ConfigError(f"{place}: not TOML: {error}; {_advice()}") from error


_Rows = tuple[str, dict[str, CostRow], dict[str, CostRow], dict[str, CountError]]
_Base = tuple[dict[str, CostRow], dict[str, CostRow], Mapping[str, CountError]]


def _parse(place: str, content: bytes) -> _Rows:
    return parse_rows(place, read_tables(place, content))


def parse_rows(place: str, data: Mapping[str, Any], *, is_part: bool = False) -> _Rows:
    """Return name, cost rows, memory rows and errors of counts; missing rows are those of the base, if there is one.

    Parameters
    ----------
    place
        Place of the tables, for messages.
    is_part
        True if every memory row is optional, because the part may not have what it describes.

    Raises
    ------
    ConfigError
        If a table is invalid; the message names its place and a remedy.
    """
    for key in sorted(data.keys() - set(_TABLES)):
        raise UnknownKeyError(key, where=place, known=_TABLES)
    name = data.get("name")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ConfigError(
            f"{place}: name: must be at most 64 lower-case letters, digits, '.', '-' and '/', not {shown(name)}; "
            'write for example name = "my-board/1"'
        )
    rows, memory, errors = _base(place, name, data["base"]) if "base" in data else ({}, {}, {})
    if "memory_base" in data:
        _, memory, _ = _base(place, name, data["memory_base"], key="memory_base")
    if "cost" in data or not rows:
        rows = _table(place, "cost", data.get("cost"), ROWS, rows, RULES)
    if "memory" in data:
        required, optional = ({}, MEMORY_ROWS | MEMORY_RULES) if is_part else (MEMORY_ROWS, MEMORY_RULES)
        memory = _table(place, "memory", data["memory"], required, memory, optional)
    _check_division(place, rows)
    _check_accumulation(place, rows, own="fp_accumulate_hidden" in data.get("cost", {}))
    _check_cache(place, memory)
    _check_sums(place, rows)
    return name, rows, memory, dict(errors) | _errors(place, data.get("error", {}))


def _errors(place: str, table: Any) -> dict[str, CountError]:
    if not isinstance(table, dict):
        raise ConfigError(f"{place}: error: must be tables of permille and source, not {shown(table)}")
    errors = {}
    for name, error in table.items():
        if name not in ERROR_PLACES:
            raise UnknownKeyError(name, where=f"{place}: error", known=ERROR_PLACES)
        permille = error.get("permille") if isinstance(error, dict) else None
        if (
            not isinstance(permille, list)
            or [type(bound) for bound in permille] != [int, int]
            or not -_MOST_PERMILLE <= permille[0] <= 0 <= permille[1] <= _MOST_PERMILLE
        ):
            raise ConfigError(
                f"{place}: error.{name}.permille: must be two whole numbers around 0, such as [-5, 10], not "
                f"{shown(permille)}"
            )
        errors[name] = CountError((permille[0], permille[1]), _source(f"{place}: error.{name}", error))
    return errors


def _base(place: str, name: str, base: Any, *, key: str = "base") -> _Base:
    if not isinstance(base, str) or base not in shipped_profiles() or base == name:
        names = ", ".join(shipped_profile for shipped_profile in shipped_profiles() if shipped_profile != name)
        raise ConfigError(f"{place}: {key}: must be a shipped profile: {names}; not {shown(base)}")
    profile = load_profile(base)
    return profile.rows, profile.memory, profile.errors


def _table(
    place: str,
    table: str,
    rows: Any,
    required: Mapping[str, str],
    base: dict[str, CostRow],
    optional: Mapping[str, str],
) -> dict[str, CostRow]:
    if not isinstance(rows, dict):
        raise ConfigError(f"{place}: there is no table [{table}.ROW]; {_advice(table)}")
    names = (*required, *optional)
    for key in sorted(rows.keys() - set(names)):
        raise UnknownKeyError(key, where=f"{place}: {table}", known=names)
    if missing := [row for row in required if row not in rows and row not in base]:
        raise ConfigError(f"{place}: {table}.{missing[0]} is missing, {len(missing)} rows in total; {_advice(table)}")
    return {
        row: _row(f"{place}: {table}.{row}", row, rows[row]) if row in rows else base[row]
        for row in names
        if row in rows or row in base
    }


def _row(place: str, row: str, table: Any) -> CostRow:
    if not isinstance(table, dict):
        raise ConfigError(f"{place}: must be a table of value, band and source, not {shown(table)}")
    for key in sorted(table.keys() - set(_KEYS)):
        raise UnknownKeyError(key, where=place, known=_KEYS)
    band = table.get("band")
    if not isinstance(band, list) or len(band) != 2:
        raise ConfigError(f"{place}.band: must be the lowest and the highest cycles, such as [2, 3], not {shown(band)}")
    value = _cycles(f"{place}.value", row, table.get("value"))
    low, high = (_cycles(f"{place}.band", row, bound) for bound in band)
    if not low <= value <= high:
        raise ConfigError(f"{place}.band: {low} to {high} does not contain the value {value}; correct one of them")
    source = _source(place, table)
    against = table.get("against", "")
    if against != "" and (against not in ROWS or against == row):
        raise ConfigError(f"{place}.against: must be the name of another row, not {shown(against)}")
    return CostRow(value, (low, high), source, against)


def _source(place: str, table: Mapping[str, Any]) -> str:
    source = table.get("source")
    if not isinstance(source, str) or not 0 < len(source.strip()) <= 500:
        raise ConfigError(f"{place}.source: must state the origin of the number in up to 500 characters")
    if not source.isprintable():  # a terminal would execute control characters
        raise ConfigError(f"{place}.source: must be one line of printable characters, not {shown(source)}")
    return source


def _cycles(place: str, row: str, cycles: Any) -> int:
    least, most = AT_LEAST.get(row, 0), _AT_MOST.get(row, _MOST_CYCLES)
    if not isinstance(cycles, int) or isinstance(cycles, bool) or not least <= cycles <= most:
        expected = "whole cycles" if row not in MEMORY_ROWS else "a whole number"
        raise ConfigError(f"{place}: must be {expected} from {least} to {most}, not {shown(cycles)}")
    if row in _POWERS_OF_TWO and cycles & (cycles - 1):
        raise ConfigError(f"{place}: must be a power of two, not {cycles}")
    return cycles


def _check_division(place: str, rows: dict[str, CostRow]) -> None:
    busy, use = rows["fp_divide"], rows["fp_divide_use"]
    ends = zip((busy.value, *busy.band), (use.value, *use.band), strict=True)
    if not all(0 <= at_use - at_busy <= 1 for at_busy, at_use in ends):
        raise ConfigError(
            f"{place}: cost.fp_divide_use must be fp_divide or one cycle more, also at the ends of their bands: "
            "the result can be used when the FPU is free, or a cycle later"
        )


def _check_accumulation(place: str, rows: dict[str, CostRow], *, own: bool) -> None:
    """Reject more hidden cycles than possible; only the range of a base may be larger."""
    most, hidden = rows["fp_accumulate"].band[1], rows["fp_accumulate_hidden"]
    if hidden.value >= most or (own and hidden.band[1] >= most):
        raise ConfigError(
            f"{place}: cost.fp_accumulate_hidden and its band must be less than {most}, the end of fp_accumulate's "
            "band: the cycle of its issue is never hidden"
        )


def _check_cache(place: str, memory: dict[str, CostRow]) -> None:
    entry, line = memory.get("cache_entry_bytes"), memory.get("flash_line_bytes")
    if entry and line and entry.value > line.value:
        raise ConfigError(
            f"{place}: memory.cache_entry_bytes must be at most flash_line_bytes: one read of the flash fills an entry"
        )


def _check_sums(place: str, rows: dict[str, CostRow]) -> None:
    for name, row in rows.items():
        if not row.against:
            continue
        other = rows[row.against]
        sums = {row.value + other.value, row.band[0] + other.band[1], row.band[1] + other.band[0]}
        if len(sums) > 1:
            raise ConfigError(
                f"{place}: cost.{name}.against: its sum with {row.against} is {min(sums)} to {max(sums)} cycles; "
                "opposite ends of the two bands must have the same sum as the values"
            )
