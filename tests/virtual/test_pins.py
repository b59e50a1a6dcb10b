"""LEDs and buttons: what firmware does to its pins is seen as events, and what a person does reaches its pins."""

from __future__ import annotations

import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.peripherals.pin_signals import PinSignal
from hiltest.virtual.peripherals.port import Gpio, Port
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.nvic import FIRST_INTERRUPT, Nvic
from hiltest.virtual.program.elf import load_image
from hiltest.world import EarthField, MagneticDistortion, World
from hiltest.world.sensors import Fxos8700cq

from .conftest import PROGRAMS, SHIPPED, Build, follow, word

PDOR, PSOR, PCOR, PTOR, PDIR, PDDR = range(0, 0x18, 4)
GPIO, ISFR, GPCLR, GPCHR = 1 << 8, 0xA0, 0x80, 0x84


@pytest.fixture
def processor() -> Processor:
    return Processor(load_image(SHIPPED), load_profile(DEFAULT_PROFILE))


@pytest.fixture
def nvic(processor: Processor) -> Nvic:
    return processor.nvic


@pytest.fixture
def ports(processor: Processor) -> list[Port]:
    modules = [module for module in mk64f12().peripherals if module.name.startswith("PORT")]
    return [Port(processor, module, {}) for module in modules]


@pytest.fixture
def port(ports: list[Port]) -> Port:
    return ports[0]


@pytest.fixture
def gpio(processor: Processor, ports: list[Port]) -> Gpio:
    return Gpio(processor.machine, ports)


def pending(nvic: Nvic) -> bool:
    return FIRST_INTERRUPT + 59 in nvic.pending


def test_a_button_lights_an_led_and_both_are_events(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "pins.c"), strict=True)
    board.run_until(0.001)
    assert board.events == []  # set high before they became outputs: nothing flashed
    board.press("SW2")
    pressed_s = board.time_s
    board.run_until(0.002)
    assert board.is_on("LED red")
    board.release("SW2")
    board.run_until(0.003)
    assert [(event.part, event.on) for event in board.events] == [
        ("SW2", True),
        ("LED red", True),
        ("SW2", False),
        ("LED red", False),
    ]
    assert board.events[0].time_s == pressed_s
    # A round of the loop that polls is some twenty cycles.
    assert 0 < board.events[1].time_s - pressed_s < 1e-6
    assert str(board.events[1]).endswith(" s: LED red on")
    assert not board.is_on("LED red")


def test_an_edge_interrupts_once_and_its_flag_is_cleared(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "pins.c"))
    board.run_until(0.001)
    for _ in range(3):
        board.press("SW3")
        board.run_until(board.time_s + 0.001)
        board.release("SW3")
        board.run_until(board.time_s + 0.001)
    assert (word(board, "edges"), word(board, "seen")) == (3, 1 << 4)


def test_pulls_give_open_pins_their_level(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "pins.c"))
    follow(board, {0.001: {"floating": 0, "pulled_up": 1}})


def test_what_the_board_does_not_have_is_named_with_what_it_has(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "pins.c"))
    with pytest.raises(ConfigError, match="no 'SW1'; it has SW2, SW3"):
        board.press("SW1")


def test_a_reset_of_the_chip_puts_the_leds_out(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "pins.c"))
    board.press("SW2")
    board.run_until(0.001)
    board.boot()
    assert not board.is_on("LED red")
    assert board.is_on("SW2")  # the finger stays


@pytest.mark.parametrize(
    ("condition", "level", "rises", "falls"),
    [(0, 0, False, False), (9, 0, True, False), (10, 0, False, True), (11, 0, True, True)],
)
def test_edges_interrupt_as_configured(
    port: Port, nvic: Nvic, condition: int, level: int, rises: bool, falls: bool
) -> None:
    port.write(0x10, 4, GPIO | condition << 16)
    port.drive(4, True)
    assert pending(nvic) == rises
    port.write(ISFR, 4, 1 << 4)
    nvic.unpend(FIRST_INTERRUPT + 59)
    port.drive(4, False)
    assert pending(nvic) == falls


def test_a_level_interrupts_until_it_ends(port: Port, nvic: Nvic) -> None:
    port.drive(4, True)
    port.write(0x10, 4, GPIO | 8 << 16)  # while low
    assert not pending(nvic)
    port.drive(4, False)
    port.write(ISFR, 4, 1 << 4)
    assert port.read(ISFR, 4) == 1 << 4  # still low
    assert port.read(0x10, 4) >> 24 & 1
    port.drive(4, True)
    port.write(0x10, 4, GPIO | 8 << 16 | 1 << 24)  # ISF in the pin's own register
    assert port.read(ISFR, 4) == 0


def test_an_analog_pin_has_no_level_and_another_function_drives_nothing(port: Port, gpio: Gpio) -> None:
    port.drive(3, True)
    assert gpio.read(PDIR, 4) == 0
    port.write(0x0C, 4, 2 << 8)
    assert gpio.read(PDIR, 4) == 1 << 3
    gpio.write(PDDR, 4, 1 << 3)
    assert port.driven_low == 0


def test_bits_are_set_cleared_and_toggled_one_by_one(gpio: Gpio) -> None:
    gpio.write(PDOR, 4, 0x0F0F)
    gpio.write(PSOR, 4, 0x00F0)
    gpio.write(PCOR, 4, 0x0003)
    gpio.write(PTOR, 4, 0x8001)
    assert gpio.read(PDOR, 4) == 0x8FFD
    gpio.write(PDDR + 1, 1, 0x80)  # a byte of the register
    assert gpio.read(PDDR, 4) == 0x8000
    assert gpio.read(PDDR + 1, 1) & 0xFF == 0x80
    assert [gpio.read(register, 4) for register in (PSOR, PCOR, PTOR)] == [0, 0, 0]


def test_many_pins_are_configured_by_one_write(port: Port) -> None:
    port.write(GPCLR, 4, 0x8001 << 16 | GPIO)
    port.write(GPCHR, 4, 0x0002 << 16 | GPIO | 3)
    configured = {pin: port.read(4 * pin, 4) for pin in range(32) if port.read(4 * pin, 4)}
    assert configured == {0: GPIO, 15: GPIO, 17: GPIO | 3}


@pytest.mark.parametrize("follows", [False, True])
def test_a_pin_that_somebody_follows_has_a_signal_that_tells_of_each_edge(port: Port, follows: bool) -> None:
    levels = [False]
    signal = PinSignal(on_level=lambda _high: None, level=lambda: levels[-1])
    messages: list[int] = []
    port.on_change = lambda _port: messages.append(port.driven_low >> 3 & 1)
    port.watch(1 << 3, follows_timers=follows)
    port.connect(3, 4, signal)
    port.write(0x0C, 4, 4 << 8)
    assert (signal.has_listeners, messages) == (follows, [1] if follows else [])
    for level in (True, False):
        levels.append(level)
        signal.report_change()
    assert messages == ([1, 0, 1] if follows else [])
    assert port.levels == 0
    levels.append(True)
    assert port.levels == 1 << 3
    port.write(0x0C, 4, 0)
    assert not signal.has_listeners


@pytest.mark.parametrize("name", ["PTF0", "PTC32", "PTC", "PT", "", "C5", "PTC05", "PTC\u0665", "ptc5", "PTCB5"])
def test_a_pin_that_is_none_is_refused_wherever_it_is_named(build: Build, name: str) -> None:
    part = Fxos8700cq(World(EarthField(48.5, 62.0)), MagneticDistortion(), seed=1)
    board = VirtualK64F(build(PROGRAMS / "pins.c"), i2c0=[part])
    for ask in (
        lambda: board.level(name),
        lambda: board.drive(name, True),
        lambda: board.connect_interrupts("i2c0", part, {"INT2": name}),
    ):
        with pytest.raises(ConfigError, match=r"the MK64FN1M0 has no pin .*; write PTA0 to PTE31"):
            ask()
