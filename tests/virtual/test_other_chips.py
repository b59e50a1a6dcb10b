"""Images for other chips are recognised by names, memories, registers or interrupts, and the board refuses them."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest
from tests.command_files import run
from tests.foreign_elf import foreign_elf

from hiltest import VirtualK64F, cycles
from hiltest.boards import default_firmware
from hiltest.errors import BoardFault, ConfigError
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.program.elf import load_image
from hiltest.virtual.program.other_chips import other_chip, small_part

Link = Callable[..., Path]

LAYOUT = """
MEMORY {{ FLASH (rx) : ORIGIN = 0x{flash:08x}, LENGTH = 64K  RAM (rwx) : ORIGIN = 0x{ram:08x}, LENGTH = 4K }}
SECTIONS {{ .text : {{ KEEP(*(.vectors)) *(.text*) *(.rodata*) }} >FLASH .data : {{ *(.data*) }} >RAM AT>FLASH
 .bss : {{ *(.bss*) }} >RAM }}
"""
# Start-up code of a chip: its vector table, and the first writes to its registers.
PROGRAM = """
void Reset_Handler(void) __attribute__((noreturn));
void Default_Handler(void) {{ for (;;) {{ }} }}
void Own_Handler(void) {{ *(volatile int *)0x{stack:08x} = 1; }}
__attribute__((section(".vectors"), used)) void (*const vectors[128])(void) = {{
  (void (*)(void))0x{stack:08x}, Reset_Handler, [2 ... 127] = Default_Handler, {own}
}};
__attribute__((noinline)) int twice(int number) {{ return 2 * number; }}
volatile int heading_deg;
const char *volatile line = "HDG=%d\\r\\n";
{drivers}
void Reset_Handler(void) {{ {calls} heading_deg = twice(1); for (;;) {{ }} }}
"""


@pytest.fixture
def link(tmp_path: Path, require_tool: Callable[[str], str]) -> Link:
    """Return a function that links a program for a chip, as an ELF, a stripped ELF, Intel HEX or a raw binary."""
    compiler, copier = require_tool("arm-none-eabi-gcc"), require_tool("arm-none-eabi-objcopy")

    def linked(
        flash: int = 0,
        stack: int = 0x20030000,
        *,
        file: str = "program.c",
        registers: tuple[int, ...] = (),
        own_handlers: tuple[int, ...] = (),
        form: str = "elf",
        flags: tuple[str, ...] = ("-mcpu=cortex-m4",),
    ) -> Path:
        drivers = "\n".join(
            f"__attribute__((noinline)) void drive_{address:x}(void) {{ *(volatile int *)0x{address:08x} = 1; }}"
            for address in registers
        )
        calls = " ".join(f"drive_{address:x}();" for address in registers)
        own = "".join(f"[{number}] = Own_Handler" for number in own_handlers)
        (tmp_path / "layout.ld").write_text(LAYOUT.format(flash=flash, ram=stack - 0x1000))
        (tmp_path / file).write_text(PROGRAM.format(stack=stack, drivers=drivers, calls=calls, own=own))
        elf = tmp_path / "app.elf"
        options = [*flags, "-mthumb", "-O1", "-nostdlib", "-ffreestanding", "-Wl,--build-id=none"]
        subprocess.run(
            [compiler, *options, f"-Wl,-T,{tmp_path / 'layout.ld'}", "-o", str(elf), file],
            check=True,
            timeout=60,
            cwd=tmp_path,
        )
        if form == "elf":
            return elf
        kinds = {"stripped": ("--strip-all",), "hex": ("-O", "ihex"), "bin": ("-O", "binary")}
        image = tmp_path / {"stripped": "app2.elf", "hex": "app.hex", "bin": "app.bin"}[form]
        subprocess.run([copier, *kinds[form], str(elf), str(image)], check=True, timeout=60)
        return image

    return linked


#: Name in the refusal, first address of flash, initial stack pointer, and the name of CMSIS's or the vendor's file.
NAMED = [
    ("an MK22F51212 image", 0, 0x20010000, "system_MK22F51212.c"),
    ("an MK66F18 image", 0, 0x20030000, "system_MK66F18.c"),
    ("an MKL25Z4 image", 0, 0x20003000, "startup_MKL25Z4.c"),
    ("an MK20DX128 image", 0, 0x20002000, "mk20dx128.c"),
    ("an STM32F4 image", 0x08000000, 0x20020000, "system_stm32f4xx.c"),
    ("an STM32H7 image", 0x08000000, 0x20020000, "stm32h7xx_hal_gpio.c"),
    ("a GD32F30X image", 0x08000000, 0x20010000, "gd32f30x_rcu.c"),
    ("an nRF52840 image", 0, 0x20030000, "system_nrf52840.c"),
    ("an nRF9160 image", 0x00008000, 0x20020000, "system_nrf9160.c"),
    ("an RP2040 image", 0x10000000, 0x20042000, "rp2040_startup.c"),
    ("a SAMD51 image", 0, 0x20030000, "startup_samd51.c"),
    ("a SAM3X8E image", 0x00080000, 0x20088000, "startup_sam3x8e.c"),
    ("an LPC1768 image", 0, 0x10008000, "startup_lpc1768.c"),
    ("an MIMXRT1062 image", 0x60002000, 0x20020000, "system_mimxrt1062.c"),
    ("a TM4C123 image", 0, 0x20008000, "startup_tm4c123.c"),
    ("an MSP432P401R image", 0, 0x20010000, "system_msp432p401r.c"),
    ("a CC2652R7 image", 0, 0x20014000, "startup_cc2652r7.c"),
    ("an EFM32GG image", 0, 0x20020000, "startup_efm32gg.c"),
    ("an XMC4500 image", 0x08000000, 0x20010000, "startup_xmc4500.c"),
    ("a MAX32660 image", 0, 0x20018000, "system_max32660.c"),
    ("an R7FA6M5 image", 0, 0x20010000, "startup_r7fa6m5.c"),
]


@pytest.mark.parametrize(("name", "flash", "stack", "file"), NAMED)
def test_an_image_is_recognised_by_the_names_in_it(name: str, flash: int, stack: int, file: str, link: Link) -> None:
    with pytest.raises(ConfigError, match=rf"this is {name} .*\(it names .*`hiltest profile`"):
        VirtualK64F(link(flash, stack, file=file))


#: Names in the refusal, first address of flash, stack, registers that the start-up code of such chips writes, handlers
#: that only they have, and the form of the file.
UNNAMED = [
    ("STM32F2, STM32F4 or STM32F7", 0x08000000, 0x20020000, (0x40023830, 0x40020000, 0x40011008), (), "bin"),
    ("STM32F1", 0x08000000, 0x20005000, (0x40021018, 0x40010800), (), "hex"),
    ("STM32F0, STM32F3, STM32L4 or STM32G4", 0x08000000, 0x20018000, (0x4002104C, 0x48000000), (), "stripped"),
    ("STM32L0, STM32G0 or STM32C0", 0x08000000, 0x20002000, (0x40021034, 0x50000000), (), "bin"),
    ("STM32H7", 0x08000000, 0x20020000, (0x580244E0, 0x58020400), (), "hex"),
    ("nRF52", 0, 0x20010000, (0x5000051C, 0x4001E504, 0x40002500), (), "bin"),
    ("nRF51 or nRF52", 0, 0x20004000, (0x5000051C, 0x4001E504, 0x40002500), (), "bin"),
    ("RP2040 or RP2350", 0x10000000, 0x20040000, (0x4000C000, 0x400140CC), (), "hex"),
    ("SAMD20, SAMD21 or SAML21", 0, 0x20008000, (0x40000800, 0x41004400), (), "bin"),
    ("SAMD51 or SAME5x", 0, 0x20030000, (0x41004000, 0x41008000, 0x40001C80), (), "stripped"),
    ("LPC17xx or LPC40xx", 0, 0x10008000, (0x400FC0C4, 0x2009C000), (), "bin"),
    ("TM4C or LM4F", 0, 0x20008000, (0x400FE608, 0x40025400), (), "hex"),
    ("MK22F or Kinetis", 0, 0x20010000, (0x40048100, 0x4002A000), (), "bin"),
    ("MK22F or Kinetis", 0, 0x20010000, (0x40048100, 0x4005200E), (46,), "hex"),
    ("MK66F or MK65F or Kinetis", 0, 0x20030000, (0x40048100, 0x4005200E), (102,), "bin"),
]


@pytest.mark.parametrize(("name", "flash", "stack", "registers", "own_handlers", "form"), UNNAMED)
def test_an_image_without_names_is_recognised_by_its_memories_registers_and_interrupts(
    name: str, flash: int, stack: int, registers: tuple[int, ...], own_handlers: tuple[int, ...], form: str, link: Link
) -> None:
    image = link(flash, stack, registers=registers, own_handlers=own_handlers, form=form)
    with pytest.raises(ConfigError, match=f"this is an? {name} image \\(its code is at 0x"):
        VirtualK64F(image)


def test_addresses_that_code_makes_of_two_halves_count_as_well(link: Link) -> None:
    flags = ("-mcpu=cortex-m4", "-mslow-flash-data")
    assert other_chip(load_image(link(0, 0x20010000, registers=(0x40002500, 0x4001E504), form="bin", flags=flags)))
    assert (
        other_chip(load_image(link(0, 0x20010000, registers=(0x40049014, 0x4004803C), form="bin", flags=flags))) is None
    )


@pytest.mark.parametrize(
    "file", ["system_MK64F12.c", "system_MK24F12.c", "board_frdm_k64f.c", "nrf24l01.c", "program.c"]
)
@pytest.mark.parametrize("form", ["elf", "bin"])
def test_images_of_the_same_chip_and_of_unknown_ones_run(file: str, form: str, link: Link) -> None:
    board = VirtualK64F(link(file=file, registers=(0x40048038, 0x20001000), form=form))
    board.run_until(0.001)
    assert "in a branch to itself" in board.position()


def test_another_chip_of_which_nothing_but_the_memories_is_known_is_refused_with_them(link: Link) -> None:
    with pytest.raises(
        ConfigError, match=r"an image for another chip \(its code is at 0x080.*, as on STM32, GD32, AT32"
    ):
        VirtualK64F(link(0x08000000, 0x20005000, form="bin"))


@pytest.mark.parametrize(
    ("flags", "attribute"),
    [(("-mcpu=cortex-m33",), "Armv8-M Mainline"), (("-mcpu=cortex-m7", "-mfpu=fpv5-d16"), "unit")],
)
def test_an_image_for_another_core_is_named_too(flags: tuple[str, ...], attribute: str, link: Link) -> None:
    image = link(0x08000000, 0x20010000, file="system_stm32l5xx.c", flags=(*flags, "-mfloat-abi=softfp"))
    with pytest.raises(ConfigError, match=f"this is an STM32L5 image .*: its attributes say .*{attribute}"):
        VirtualK64F(image)


@pytest.mark.parametrize(
    ("machine", "title"), [(94, "an Xtensa processor"), (243, "a RISC-V processor"), (83, "an AVR")]
)
def test_an_image_for_another_architecture_is_named(machine: int, title: str) -> None:
    content = bytearray(default_firmware().read_bytes())
    content[18:20] = machine.to_bytes(2, "little")
    with pytest.raises(ConfigError, match=f"built for {title}, as"):
        VirtualK64F(bytes(content))


def test_functions_of_another_chip_s_image_are_counted_and_its_registers_are_nobody_s(link: Link) -> None:
    image = link(0, 0x20010000, file="system_MK22F51212.c", registers=(0x40048038,))
    assert cycles(image).call("twice", 21).value == 42
    with pytest.raises(
        BoardFault, match="0x40048038, where no peripheral is modelled: the memories are another part's"
    ):
        cycles(image).call("Reset_Handler")


def test_a_rig_that_is_proposed_for_another_chip_is_for_its_own_board(
    link: Link, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = link(0x08000000, 0x20020000, file="stm32h7xx_hal_gpio.c")
    assert run("init", str(tmp_path / "mine"), "--firmware", str(image)) == 0
    assert "this is an STM32H7 image" in capsys.readouterr().out
    rig = load_rig(tmp_path / "mine" / "hil" / "rigs" / "mine.toml")
    assert (rig.board.kind, rig.board.firmware, rig.world) == ("real", None, None)
    assert rig.device is not None
    assert rig.turntable.kind == "operator"


def test_an_image_for_a_chip_of_another_virtual_board_names_it(link: Link) -> None:
    chips = {"stm32f407xx": "stm32f407-disco", "stm32f411xe": "stm32f411-disco", "stm32l476xx": None}
    found = {name: other_chip(load_image(link(0x08000000, 0x20018000, file=f"{name}.c"))) for name in chips}
    assert {name: chip and chip.machine for name, chip in found.items()} == chips


def test_a_rig_that_is_proposed_for_an_nrf51_is_of_the_virtual_microbit(link: Link, tmp_path: Path) -> None:
    image = link(0, 0x20004000, file="nrf51822.c", flags=("-mcpu=cortex-m0",))
    assert run("init", str(tmp_path / "mine"), "--firmware", str(image)) == 0
    rig = load_rig(tmp_path / "mine" / "hil" / "rigs" / "mine.toml")
    assert (rig.board.kind, rig.board.machine) == ("virtual", "microbit-v1")
    assert {place.bus for place in rig.parts.values()} == {"i2c0"}
    assert rig.board.firmware is not None


@pytest.mark.parametrize(
    ("version", "named"),
    [
        ("microbitv1/v1.1.1", r"this is an nRF51 image .* uses [45] of its register.*microbit-v1"),
        ("microbitv2/v2.1.2", r"this is an nRF52 image .* uses [45] of its register"),
    ],
)
def test_micropython_of_the_microbit_is_recognised(
    version: str, named: str, require_module: Callable[[str], None]
) -> None:
    require_module("micropython_microbit_fs")
    (image,) = (Path(str(resources.files("micropython_microbit_fs"))) / "hexes" / version).glob("*.hex")
    with pytest.raises(ConfigError, match=named):
        VirtualK64F(image)


@pytest.mark.parametrize(
    ("name", "chip"),
    [("l4r5_mayo1_m4f.elf", "STM32L4"), ("nrf52_small.elf", ""), ("stm32g474_gale.elf", ""), ("fndsa_46d5b68.elf", "")],
)
def test_public_programs_of_other_chips_are_refused(name: str, chip: str) -> None:
    found = other_chip(load_image(foreign_elf(name)))
    assert found is not None
    assert found.name == chip


NRF_PORT = tuple(range(0x50000500, 0x50000780, 4))  # 160 registers, as many calls


@pytest.mark.parametrize("form", ["elf", "bin"])
@pytest.mark.parametrize(
    ("cpu", "name", "machine"), [("cortex-m0", "nRF51", "microbit-v1"), ("cortex-m4", "nRF52", None)]
)
def test_the_core_tells_an_nrf51_from_an_nrf52_of_the_same_layout(
    cpu: str, name: str, machine: str | None, form: str, link: Link
) -> None:
    registers = (*NRF_PORT, 0x4001E504, 0x40002500)
    chip = other_chip(load_image(link(0, 0x20004000, registers=registers, form=form, flags=(f"-mcpu={cpu}",))))
    assert chip is not None
    assert (chip.name, chip.machine) == (name, machine)


def test_names_of_an_nrf51_in_code_for_a_larger_core_are_those_of_an_nrf52(link: Link) -> None:
    image = load_image(link(0, 0x20004000, file="nrf51_to_nrf52840.c", registers=(0x5000051C, 0x4001E504)))
    chip = other_chip(image)
    assert chip is not None
    assert (chip.name, chip.machine) == ("nRF52", None)
    assert small_part(image) is None


def test_a_short_image_that_may_be_either_nrf_names_no_machine(link: Link) -> None:
    chip = other_chip(load_image(link(0, 0x20004000, registers=(0x5000051C, 0x4001E504), form="hex")))
    assert chip is not None
    assert (chip.name, chip.machine) == ("nRF51 or nRF52", None)


#: Model of the cycles, CPU, name of the file, begin of the flash, initial stack.
SMALL = [
    ("nrf51822/1", "cortex-m0", "nrf51822.c", 0, 0x20004000),
    ("generic-m0/1", "cortex-m0", "nrf51822.c", 0, 0x20008000),
    ("generic-m0/1", "cortex-m0", "stm32f030x8.c", 0x08000000, 0x20002000),
    ("generic-m0plus/1", "cortex-m0plus", "stm32g031xx.c", 0x08000000, 0x20002000),
    ("generic-m0plus/1", "cortex-m0plus", "rp2040.c", 0x10000000, 0x20040000),
]


@pytest.mark.parametrize(("model", "cpu", "file", "flash", "stack"), SMALL)
def test_functions_of_an_image_for_a_small_core_are_counted_by_its_prices(
    model: str, cpu: str, file: str, flash: int, stack: int, link: Link
) -> None:
    image = link(flash, stack, file=file, flags=(f"-mcpu={cpu}",))
    called = cycles(image).call("twice", 21)
    part = model.partition("/")[0]
    assert (called.value, called.cycles) == (42, cycles(image, part=part).call("twice", 21).cycles)
    assert called.cycle_model.startswith(model)


@pytest.mark.parametrize("cpu", ["cortex-m0", "cortex-m0plus"])
def test_options_of_the_compiler_tell_small_cores_apart_and_without_them_the_user_must(cpu: str, link: Link) -> None:
    flags = (f"-mcpu={cpu}",)
    assert cycles(link(flags=(*flags, "-g"))).call("twice", 21).cycle_model.startswith(f"generic-{cpu[7:]}/1")
    with pytest.raises(
        ConfigError, match=r"built for Armv6-M, and neither .* --part generic-m0 or --part generic-m0plus"
    ):
        cycles(link(flags=flags))


def test_the_layout_of_a_small_core_s_image_stays_its_own_with_memories_of_the_user(link: Link) -> None:
    image = link(0, 0x20004000, file="nrf51822.c", flags=("-mcpu=cortex-m0",))
    called = cycles(image, memory="flash=0:256K,ram=0x20000000:32K").call("twice", 21)
    assert called.cycle_model.startswith("generic-m0/1")
