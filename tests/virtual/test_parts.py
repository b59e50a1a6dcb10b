"""Parts: where their memories are, what these add to the cycles of a sequence, and what their files refuse."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from hiltest import cycles
from hiltest.errors import ConfigError, UnknownKeyError
from hiltest.measurement.cycle_range import DOUBT
from hiltest.virtual.part.part_file import load_part, shipped_parts
from hiltest.virtual.profiling.document import document

MHZ = 1_000_000
Count = Callable[..., int]
#: A function whose address and data the linker places; r1 and r2 are addresses of its data, r3 of another one.
SOURCE = """
    .syntax unified
    .thumb
    .section .vectors, "a"
    .word stack_top, work
    .section .fast, "ax", %progbits
    .balign 16
    .global work
    .type work, %function
    .thumb_func
work:
    push {{r4-r7}}
    ldr r1, =near
    movs r2, #64
    adds r2, r1
    {fpu}
    ldr r3, =far
    movs r0, #0
    .balign 4
    {sequence}
    .balign 4
    nop
    pop {{r4-r7}}
    bx lr
    .ltorg
    .size work, . - work
    .section .near, "aw", %progbits
    .balign 16
near:
    .space 256
    .section .far, "aw", %progbits
    .balign 16
far:
    .space 256
"""
SCRIPT = """
SECTIONS {{
    .vectors {code:#x} - 0x100 : {{ *(.vectors) }}
    .fast {code:#x} : {{ *(.fast) }}
    .near {near:#x} : {{ *(.near) }}
    .far {far:#x} : {{ *(.far) }}
    stack_top = {stack:#x};
}}
"""
FLASH, SRAM1, SRAM2 = 0x08001000, 0x20000000, 0x2001C000
REMAPPED = 0x1000
M4 = ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
FLAGS_OFFSET, HARD_FLOAT = 36, 0x400  # e_flags of the ELF header
M33 = ("-mcpu=cortex-m33", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard")


class Linker:
    """Links a sequence, with its code, data and stack at any addresses."""

    def __init__(self, compiler: str, folder: Path) -> None:
        self._compiler, self._folder = compiler, folder

    def link(
        self,
        sequence: str,
        *,
        code: int = FLASH,
        near: int = SRAM1,
        far: int = SRAM1 + 0x1000,
        stack: int = SRAM1 + 0x8000,
        core: Sequence[str] = M4,
    ) -> Path:
        source, script, elf = (self._folder / name for name in ("work.S", "work.ld", "work.elf"))
        source.write_text(SOURCE.format(sequence=sequence, fpu="vmov s0, r1" if len(core) > 1 else ""))
        script.write_text(SCRIPT.format(code=code, near=near, far=far, stack=stack))
        flags = [*core, "-mthumb", "-nostdlib", "-Wl,-e,work"]
        places = ["-Wl,--build-id=none,--no-warn-rwx-segments", f"-Wl,-T,{script}"]
        subprocess.run([self._compiler, *flags, *places, source, "-o", elf], check=True, timeout=60)
        return elf

    def count(self, sequence: str, **places: int) -> int:
        """Count the cycles of a sequence on an STM32F407 at 24 MHz, without those of the code around it."""
        whole, empty = (
            cycles(self.link(text, **places), part="stm32f407", clock_hz=24 * MHZ).call("work").cycles
            for text in (sequence, "nop.w")
        )
        return whole - empty + 1

    def count_on(self, part: str, core: Sequence[str], sequence: str) -> int:
        """Count the cycles of a sequence on a part, without those of the code around it."""
        whole, empty = (
            cycles(self.link(text, core=core), part=part).call("work").cycles for text in (sequence, "nop\n nop")
        )
        return whole - empty + 2


@pytest.fixture
def linker(require_tool: Callable[[str], str], tmp_path: Path) -> Linker:
    return Linker(require_tool("arm-none-eabi-gcc"), tmp_path)


@pytest.fixture
def count(linker: Linker) -> Count:
    return linker.count


@pytest.mark.parametrize(
    ("sequence", "expected"),
    [
        ("ldr.w r4, [r1]\n ldr.w r5, [r2]", 3),
        ("ldr r4, [r1], #4\n ldr.w r5, [r1]", 3),
        ("ldr r4, [r1], #4\n ldr r5, [r1], #4", 4),
        ("ldr r4, [r1], #4\n ldr r5, [r2], #4", 3),
        ("str.w r0, [r1]\n ldm.w r2, {r4, r5}", 5),
        ("str.w r0, [r1]\n stm.w r2, {r4, r5}", 4),
        ("vmov r4, s0\n ldr.w r5, [r4]", 4),
        ("vmov r4, s0\n nop.w\n ldr.w r5, [r4]", 4),
        ("ldr.w r4, [r1, #2]", 3),
        ("ldr.w r4, [r1, #1]", 4),
        ("ldrh.w r4, [r1, #1]", 3),
        ("strh.w r0, [r1, #1]", 2),
    ],
)
def test_a_sequence_takes_the_cycles_of_version_3(count: Count, sequence: str, expected: int) -> None:
    assert count(sequence) == expected


@pytest.mark.parametrize(
    ("sequence", "expected"),
    [
        ("ldr r4, [r1]\n ldr r5, [r2]", 4),
        ("ldr r4, [r1]\n str r4, [r2]", 4),
        ("str r0, [r1]\n ldr r4, [r2]", 4),
        ("str r0, [r1, r0]\n nop", 3),
        ("adds r4, r1, r0\n ldr r5, [r4]", 3),
        ("muls r4, r0\n nop", 2),
        ("push {r4, r5}\n pop {r4, r5}", 6),
        ("dmb", 3),
        ("cmp r0, #1\n beq 1f\n 1:", 2),
        ("cmp r0, #0\n beq 1f\n nop\n nop\n 1:", 3),
        ("adr r5, 1f\n adds r5, #1\n bx r5\n nop\n 1:", 4),
        ("adr r5, 1f\n adds r5, #1\n push {r4, r5}\n pop {r4, pc}\n 1:", 10),
        ("mov r7, lr\n bl 1f\n b 2f\n 1: bx lr\n 2: mov lr, r7\n nop\n nop", 11),
    ],
)
def test_a_sequence_takes_the_cycles_of_the_manual_on_a_cortex_m0plus(
    linker: Linker, sequence: str, expected: int
) -> None:
    assert linker.count_on("generic-m0plus", ["-mcpu=cortex-m0plus"], sequence) == expected


@pytest.mark.parametrize(
    ("sequence", "expected"),
    [
        ("ldr r4, [r1]\n ldr r5, [r2]", 4),
        ("muls r4, r0\n nop", 2),
        ("push {r4, r5}\n pop {r4, r5}", 6),
        ("dmb", 4),
        ("cmp r0, #1\n beq 1f\n 1:", 2),
        ("cmp r0, #0\n beq 1f\n nop\n nop\n 1:", 4),
        ("adr r5, 1f\n adds r5, #1\n bx r5\n nop\n 1:", 5),
        ("adr r5, 1f\n adds r5, #1\n push {r4, r5}\n pop {r4, pc}\n 1:", 11),
        ("mov r7, lr\n bl 1f\n b 2f\n 1: bx lr\n 2: mov lr, r7\n nop\n nop", 14),
    ],
)
def test_a_sequence_takes_the_cycles_of_the_manual_on_the_cortex_m0_of_an_nrf51822(
    linker: Linker, sequence: str, expected: int
) -> None:
    places = {"code": 0x100, "near": 0x20000000, "far": 0x20001000, "stack": 0x20004000}
    whole, empty = (
        cycles(linker.link(text, core=["-mcpu=cortex-m0"], **places), part="nrf51822").call("work").cycles
        for text in (sequence, "nop\n nop")
    )
    assert whole - empty + 2 == expected


@pytest.mark.parametrize(
    ("sequence", "expected"),
    [
        ("mul r4, r0, r0", 1),
        ("mla r4, r0, r0, r0", 2),
        ("mls r4, r0, r0, r0", 2),
        ("umull r4, r5, r0, r0", 5),
        ("smull r4, r5, r0, r0", 5),
        ("umlal r4, r5, r0, r0", 7),
        ("smlal r4, r5, r0, r0", 7),
        ("udiv r4, r0, r0", 12),
        ("mul r4, r0, r0\n ldr.w r5, [r1, r4]", 4),
        ("ldr.w r4, [r1]\n ldr.w r5, [r2]", 3),
        ("ldr r4, [r1], #4\n ldr r5, [r1], #4", 4),
        ("str.w r0, [r1]\n ldm.w r2, {r4, r5}", 5),
        ("ldr.w r4, [r1, #2]", 3),
        ("mov r7, lr\n bl 1f\n b 2f\n 1: bx lr\n 2: mov lr, r7\n nop\n nop", 11),
    ],
)
def test_a_sequence_takes_the_cycles_of_the_manual_on_a_cortex_m3(linker: Linker, sequence: str, expected: int) -> None:
    assert linker.count_on("generic-m3", ["-mcpu=cortex-m3"], sequence) == expected


@pytest.mark.parametrize(
    ("sequence", "expected"),
    [
        ("ldr.w r4, [r1]\n ldr.w r5, [r2]", 2),
        ("ldr.w r4, [r1]\n str.w r4, [r2]", 2),
        ("ldm.w r2, {r4, r5, r6}", 3),
        ("ldrd r4, r5, [r2]", 2),
        ("b.w 1f\n nop.w\n 1:", 2),
        ("umaal r4, r5, r0, r0", 1),
        ("vadd.f32 s1, s2, s3\n vadd.f32 s4, s1, s1", 3),
        ("vfma.f32 s1, s2, s3\n vfma.f32 s1, s2, s3", 4),
        ("vfma.f32 s1, s2, s3\n nop.w\n nop.w\n vfma.f32 s1, s2, s3", 4),
    ],
)
def test_a_sequence_takes_the_cycles_that_were_published_of_a_cortex_m33(
    linker: Linker, sequence: str, expected: int
) -> None:
    assert linker.count_on("generic-m33", M33, sequence) == expected


def test_loads_overlap_only_within_one_block_of_memory(count: Count) -> None:
    sequence = "ldr.w r4, [r1]\n ldr.w r5, [r3]\n ldr.w r6, [r2]"
    assert count(sequence) == 4
    assert count(sequence, far=SRAM2) == count(sequence) + 2
    assert count("ldr.w r4, [r1]\n str.w r0, [r3]") == 2
    assert count("ldr.w r4, [r1]\n str.w r0, [r3]", far=SRAM2) == 3


@pytest.mark.parametrize(
    ("sequence", "waits"),
    [
        ("ldr.w r4, [r3]", 1),
        ("ldr.w r4, [r3]\n ldr.w r5, [r3, #4]\n ldr.w r6, [r3, #8]", 1),
        ("ldr.w r4, [r3]\n nop.w\n ldr.w r5, [r3]", 2),
        ("ldm.w r3, {r4, r5, r6}", 1),
        ("stm.w r3, {r4, r5, r6}", 1),
        ("str.w r0, [r3]", 0),
        ("str.w r0, [r3]\n str.w r0, [r3, #4]", 1),
        ("str.w r0, [r3]\n str.w r0, [r3, #4]\n str.w r0, [r3, #8]", 1),
        ("str.w r0, [r3]\n ldr.w r4, [r3, #4]", 1),
        ("str.w r0, [r3]\n nop.w\n ldr.w r4, [r3, #4]", 1),
    ],
)
def test_a_late_ram_delays_each_group_of_accesses_once(count: Count, sequence: str, waits: int) -> None:
    assert count(sequence, far=SRAM2) == count(sequence) + waits


def test_a_table_in_flash_takes_seven_hundredths_of_a_cycle_a_load(count: Count) -> None:
    loads = ".rept 400\n ldr.w r4, [r3]\n nop.w\n .endr"
    assert count(loads, far=FLASH + 0x2000) == count(loads) + 28
    assert count(loads, far=FLASH + 0x2000, code=REMAPPED) == count(loads, code=REMAPPED)


def test_code_in_ram_competes_with_data_for_the_system_bus(linker: Linker) -> None:
    def count(sequence: str, code: int) -> int:
        whole, empty = (
            cycles(linker.link(text, code=code), part="nrf52840").call("work").cycles for text in (sequence, "nop.w")
        )
        return whole - empty

    accesses, divisions = ".rept 100\n ldr.w r4, [r1]\n nop.w\n .endr", ".rept 100\n udiv r4, r0, r0\n .endr"
    # Two words of code of two clocks each, and a word of data, a turn; the core fetches some words ahead.
    assert count(accesses, SRAM1 + 0x2000) == pytest.approx(500, abs=8)
    assert count(divisions, SRAM1 + 0x2000) == pytest.approx(1200, abs=8)  # the fetch keeps up


def test_flash_waits_by_the_core_clock_and_a_loop_in_the_cache_does_not(linker: Linker) -> None:
    part = load_part("stm32f407")
    assert [part.timing(mhz * MHZ).name for mhz in (24, 30, 31, 168)] == [
        "stm32f407/1-0ws",
        "stm32f407/1-0ws",
        "stm32f407/1-1ws",
        "stm32f407/1-5ws",
    ]
    sequences = {"straight": ".rept 400\n eor.w r4, r4, r5\n .endr", "loop": "movs r4, #200\n 1: subs r4, #1\n bne 1b"}
    counts = {
        (name, mhz): cycles(linker.link(sequence), part="stm32f407", clock_hz=mhz * MHZ).call("work").cycles
        for name, sequence in sequences.items()
        for mhz in (24, 168)
    }
    # A line of four instructions takes five clocks more, and the next one is read ahead: one clock a line waits.
    assert 100 <= counts["straight", 168] - counts["straight", 24] <= 140  # the code around it waits, too
    assert counts["loop", 168] - counts["loop", 24] < 40


def test_an_stm32f411_waits_by_its_own_table_and_has_one_ram_that_never_waits(linker: Linker) -> None:
    part = load_part("stm32f411")
    clocks_mhz = (16, 30, 31, 64, 65, 90, 91, 100)
    assert [part.timing(mhz * MHZ).name[-3:] for mhz in clocks_mhz] == [
        f"{waits}ws" for waits in (0, 0, 1, 1, 2, 2, 3, 3)
    ]
    straight = linker.link(".rept 400\n eor.w r4, r4, r5\n .endr")
    counts = {
        mhz: cycles(straight, part="stm32f411", clock_hz=mhz * MHZ).call("work").cycles for mhz in (30, 64, 90, 100)
    }
    # A line of four instructions takes up to four clocks, and the next one is read ahead: only the code around waits.
    assert counts[30] < counts[64] < counts[90] < counts[100] < counts[30] + 40
    for far in (SRAM1 + 0x1000, SRAM2):
        elf = linker.link("ldr.w r4, [r3]\n nop.w\n ldr.w r5, [r3]", far=far)
        assert (
            cycles(elf, part="stm32f411", clock_hz=24 * MHZ).call("work").cycles
            == cycles(linker.link("ldr.w r4, [r1]\n nop.w\n ldr.w r5, [r1]"), part="stm32f411", clock_hz=24 * MHZ)
            .call("work")
            .cycles
        )


def test_the_stack_is_where_the_image_has_it(count: Count) -> None:
    pushes = "push.w {r4-r7}\n pop.w {r4-r7}"
    assert count(pushes, stack=SRAM2 + 0x4000) == count(pushes) + 2


def test_a_call_states_its_own_use_of_the_stack(linker: Linker) -> None:
    frames = {"nop.w": 16, "push.w {r4-r7}\n pop.w {r4-r7}": 32, "sub sp, #100\n add sp, #100": 116}
    for sequence, expected in frames.items():
        image = cycles(linker.link(sequence), part="stm32f407", clock_hz=24 * MHZ)
        assert [image.call("work").stack_bytes for _ in range(2)] == [expected, expected]


def test_less_stack_than_in_an_earlier_call_is_stated() -> None:
    image = cycles()
    used = [image.call("crc32", b"123456789", 9).stack_bytes, image.call("memset", bytearray(8), 7, 8).stack_bytes]
    assert used[1] < used[0]
    assert used[0] == image.call("crc32", b"123456789", 9).stack_bytes


DIGESTS = {
    "generic-m0/1": "bc10e6a15a04286f",
    "generic-m0plus/1": "53981745529f88a0",
    "generic-m3/1": "f3ea4f089c1ecd01",
    "generic-m33/1": "c8a439973b407422",
    "generic-m4/1": "86be6a19a39fc5a3",
    "mk64f12/1": "5fb579178c51b1cf",
    "nrf51822/1": "85bc06552308aab4",
    "nrf52840/1": "cafc99b742147595",
    "stm32f407/1": "198908d40860d1d6",
    "stm32f411/1": "fdfa1936f2a53eeb",
    "stm32g4/1": "7428b9c2dbe76c37",
    "stm32l4r5/1": "704bbc7b29639790",
}


def test_every_shipped_part_has_sources_and_its_numbers_stay() -> None:
    digests = {name: load_part(name).timing().digest[:16] for name in shipped_parts()}
    assert digests == DIGESTS
    for name in shipped_parts():
        profile = load_part(name).timing()
        assert all(row.source for row in (*profile.rows.values(), *profile.memory.values()))
        assert {"sram", "flash"} <= profile.errors.keys() or profile.rows[DOUBT].value > 0


def test_a_part_is_named_without_its_version_and_a_file_of_ones_own_is_told_from_it(tmp_path: Path) -> None:
    shipped = shipped_parts()["nrf52840/1"]
    assert load_part("nrf52840").name == load_part("nrf52840/1").name == "nrf52840/1"
    own = tmp_path / "own.toml"
    own.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    assert load_part(str(own)).timing().name.startswith("nrf52840/1+")


@pytest.mark.parametrize(
    ("before", "after", "place"),
    [
        ("[part]", "[parts]", "there is no table"),
        ("kib = 256", "kib = 0", "part.memories.1.kib"),
        ("kib = 256", "kb = 256", "part.memories.1"),
        ("begin = 0x20000000", "begin = 0x00000000", "overlap"),
        ('kind = "ram"', 'kind = "flash"', "there is no RAM"),
        ('title = "nRF52840"', "", "part.title is missing"),
        ("[memory.flash_clocks]\nvalue = 3", "[memory.flash_clocks]\nvalue = 0", "memory.flash_clocks.value"),
        ("[memory.cache_ways]", "[memory.cache_way]", "cache_way"),
        ("[error.flash]\npermille = [-16, 28]", "[error.flash]\npermille = [16, 28]", "error.flash.permille"),
        ("[error.flash]", "[error.rom]", "rom"),
        ("clock_mhz = 64", 'clock_mhz = 64\ncore = "cortex-m7"', "part.core"),
    ],
)
def test_a_wrong_part_file_is_refused_with_the_place(tmp_path: Path, before: str, after: str, place: str) -> None:
    text = shipped_parts()["nrf52840/1"].read_text(encoding="utf-8")
    assert before in text
    file = tmp_path / "own.toml"
    file.write_text(text.replace(before, after), encoding="utf-8")
    with pytest.raises((ConfigError, UnknownKeyError), match=place):
        load_part(str(file))


def test_a_part_has_the_costs_of_the_part_that_is_its_base(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    part = '[part]\ntitle = "Mine"\ncore = "cortex-m0"\nmemories = []\n'
    multiply = '[cost.multiply]\nvalue = 32\nband = [32, 32]\nsource = "its manual"\n'
    own.write_text(f'name = "mine/1"\nbase = "generic-m0/1"\n{part}{multiply}', encoding="utf-8")
    rows, others = (load_part(name).timing().rows for name in (str(own), "generic-m0"))
    assert {name: row.value for name, row in rows.items() if row != others[name]} == {"multiply": 32}


def test_a_part_that_is_unknown_or_too_fast_is_refused() -> None:
    with pytest.raises(ConfigError, match="no part 'stm32f1'; known: generic-m0, generic-m0plus"):
        load_part("stm32f1")
    with pytest.raises(ConfigError, match="runs at up to 168 MHz, not 180 MHz"):
        load_part("stm32f407").timing(180 * MHZ)


def test_memories_are_those_of_the_part_or_of_the_user() -> None:
    with pytest.raises(ConfigError, match="has its own memories"):
        cycles(part="mk64f12", memory="ram=0x20000000:64K")
    assert str(cycles(part="mk64f12").memory) == "flash=0x00000000:1024K,ram=0x1fff0000:256K"


def test_the_range_of_a_count_is_that_of_published_counts() -> None:
    counted = cycles(part="mk64f12").call("crc32", b"123456789", 9)
    assert counted.cycle_model == "mk64f12/1@flash"
    assert counted.band is not None
    assert (counted.band.low, counted.band.high) == (
        counted.cycles - -(-150 * counted.cycles // 1000),
        counted.cycles + -(-150 * counted.cycles // 1000),
    )
    bare = cycles(part="generic-m4").call("crc32", b"123456789", 9)
    assert bare.band is not None
    assert bare.band.high - bare.band.low <= 0.02 * bare.cycles + 2  # rounded up at both ends


@pytest.mark.parametrize("name", ["generic-m0plus", "generic-m3", "generic-m33"])
def test_a_part_without_published_counts_has_the_range_of_its_rows(linker: Linker, tmp_path: Path, name: str) -> None:
    own = tmp_path / "own.toml"
    own.write_text(load_part(name).file.read_text(encoding="utf-8").replace(name, "my-chip"), encoding="utf-8")
    for part in (name, str(own)):
        counted = cycles(linker.link("ldr r4, [r1]\n nop", core=["-mcpu=cortex-m0plus"]), part=part).call("work")
        assert counted.cycle_model.endswith("@flash")
        assert counted.band is not None
        assert counted.band.low < counted.cycles < counted.band.high
        assert DOUBT in {effect.row for effect in counted.band.rows}


M3, M0PLUS = ["-mcpu=cortex-m3"], ["-mcpu=cortex-m0plus"]
ARCHITECTURES = {
    "generic-m0plus": [("Armv7-M", M3), ("Armv7E-M", M4), ("Armv8-M", M33)],
    "generic-m3": [("Armv7E-M", M4), ("Armv8-M", M33)],
    "generic-m4": [("Armv8-M", M33)],
    "stm32f407": [("Armv8-M", M33)],
}


@pytest.mark.parametrize(
    ("part", "architecture", "core"), [(part, *case) for part, cases in ARCHITECTURES.items() for case in cases]
)
def test_an_image_of_an_architecture_that_the_core_of_a_part_does_not_have_is_refused(
    linker: Linker, part: str, architecture: str, core: Sequence[str]
) -> None:
    with pytest.raises(ConfigError) as refusal:
        cycles(linker.link("nop\n nop", core=core), part=part)
    own = {"generic-m0plus": M0PLUS, "generic-m3": M3}.get(part, M4)
    assert all(fact in str(refusal.value) for fact in ("work.elf", architecture, own[0]))


def test_an_image_of_an_older_architecture_or_of_an_unknown_one_is_counted(linker: Linker) -> None:
    for part, cores in {"generic-m3": [M0PLUS], "generic-m4": [M0PLUS, M3], "generic-m33": [M0PLUS, M3, M4]}.items():
        for core in cores:
            assert cycles(linker.link("nop\n nop", core=core), part=part).call("work").cycles
    elf = linker.link("nop\n nop", core=M33)
    elf.write_bytes(elf.read_bytes().replace(b".ARM.attributes", b".ARM.attributez"))
    assert cycles(elf, part="generic-m33").call("work").cycles


def test_an_image_that_passes_floats_in_registers_needs_a_core_that_has_them(linker: Linker) -> None:
    elf = linker.link("nop\n nop", core=M3)
    content = bytearray(elf.read_bytes())
    content[FLAGS_OFFSET + 1] |= HARD_FLOAT >> 8
    elf.write_bytes(content)
    with pytest.raises(ConfigError, match="floating-point unit"):
        cycles(elf, part="generic-m3")
    assert cycles(elf, part="generic-m4").call("work").cycles


def test_code_on_a_bus_that_nobody_measured_has_a_note(linker: Linker) -> None:
    for name, noted in (("stm32f407", True), ("nrf52840", False)):
        elf = linker.link("nop.w", code=SRAM1 + 0x2000)
        image = cycles(elf, part=name)
        notes = document(image.call("work"), elf, (), (), (), memory=image.memory, part=image.part).notes
        assert any("system bus" in note for note in notes) == noted
