"""Rig that is proposed for a firmware, with the user's choices at a terminal."""

from __future__ import annotations

import os
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from hiltest.errors import HiltestError

_LONGEST_NAME = 64
_LEAST_SHARE = 0.0005  # share of the processor's time from which a function is busy: the tolerance of that share


def is_dialogue() -> bool:
    """Return whether a user at a terminal can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def legible_name(text: str) -> str:
    """Return a name of a rig: letters, digits, ``-`` and ``_`` of a text."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:_LONGEST_NAME] or "mine"


def propose_rig(name: str, folder: Path, firmware: Path) -> str | None:
    """Return the text of a rig for ``hil/rigs/NAME.toml`` below a folder; None if the firmware needs none.

    Firmware that speaks hiltest's own protocol needs none.

    Raises
    ------
    ConfigError
        If the file is no firmware.
    """
    from hiltest.interfaces.proposed_rig import chosen_kind, cycles_text, look_at, rig_text
    from hiltest.rig.bench_files import shipped
    from hiltest.virtual.program.elf import load_image
    from hiltest.virtual.program.other_chips import other_chip

    image = load_image(firmware)
    proposals, chip = look_at(image), other_chip(image)
    if proposals.speaks_our_protocol:
        return None
    rigs = shipped() / "rigs"
    machine = chip.machine if chip and chip.machine and (rigs / f"{chip.machine}.toml").exists() else None
    choose = ask_for_option if is_dialogue() else None
    kind = chosen_kind(proposals, choose)
    file, around = firmware.resolve(), folder.resolve()
    is_near = file.is_relative_to(around.parent)
    path = os.path.relpath(file, around / "hil" / "rigs") if is_near else str(file)
    text = rig_text(
        proposals,
        kind,
        (rigs / f"{machine or proposals.base_rig}.toml").read_text(encoding="utf-8"),
        name=name,
        firmware=None if chip and not machine else path,
        choose=choose,
        machine=machine,
    )
    if machine or not chip:
        rig = around / "hil" / "rigs" / f"{name}.toml"
        text += cycles_text(_busiest_first(proposals.functions, _shares(rig, text, file)))
    summary = f'kind = "{kind}"' if "\n[device]\n" in text else "none of them is certainly a heading: fill in [device]"
    if chip is not None:
        board = f"the rig is for the virtual board {machine}" if machine else "the rig is for its own board"
        click.echo(f"{firmware}: {chip}, which the default virtual board cannot run: {board}")
    click.echo(
        f"{firmware}: {proposals.found} names and texts found; {summary}. Guesses are comments in hil/rigs/{name}.toml"
    )
    return text


def _busiest_first(named: Sequence[str], shares: Mapping[str, float]) -> list[str]:
    """Return functions that are worth counting: the busy ones, and those called that are known by their names."""
    called = sorted(shares, key=lambda name: -shares[name])
    return [name for name in called if shares[name] >= _LEAST_SHARE or name in named] or list(named)


def _shares(rig_file: Path, text: str, firmware: Path) -> dict[str, float]:
    """Return the shares of the processor's time that functions take in a tumble.

    Functions that wait, or call one that does, are left out: their time is not work. The result is empty if the
    virtual board cannot run the firmware.
    """
    import numpy as np

    from hiltest.boards.bench import VirtualBench
    from hiltest.interfaces.proposed_rig import is_countable, is_wait
    from hiltest.rig.rig_file import parse_rig

    try:
        bench = VirtualBench(parse_rig(rig_file, text.encode()), firmware=firmware)
        bench.machine.report_waits(lambda _line: None)
        names = Counter(symbol.name for symbol in bench.machine.image.functions if is_countable(symbol))
        watch = bench.machine.watch_calls(name for name, symbols in names.items() if symbols == 1)
        bench.run_in_tumble()
    except HiltestError:
        return {}
    waits = [call for name in watch.functions if is_wait(name) for call in watch.calls(name)]
    begins = np.sort([call.entered for call in waits])
    shares: dict[str, float] = {}
    for name in watch.functions:
        summary, calls = watch.summary(name), watch.calls(name)
        waits_before = np.searchsorted(begins, [(call.entered, call.returned) for call in calls])
        if calls and summary.share is not None and not np.ptp(waits_before, axis=1).any():
            shares[name] = summary.share
    return shares


def ask_user(question: str) -> str:
    """Ask a user at a terminal, and return the typed line; the end of the input interrupts the command."""
    return str(click.prompt(question, default="", prompt_suffix="", show_default=False)).strip()


def ask_for_option(question: str, options: Sequence[str]) -> int:
    """Ask for one of several options, and return its index; Enter selects the first."""
    listed = "\n".join(f"  {number} {option}" for number, option in enumerate(options, start=1))
    while True:
        answer = ask_user(f"{question}\n{listed}\n[1] ") or "1"
        if answer in (numbers := [str(number) for number, _ in enumerate(options, start=1)]):
            return numbers.index(answer)
        click.echo(f"Answer with a number from 1 to {len(options)}.")
