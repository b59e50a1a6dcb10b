#!/usr/bin/env python3
"""Compile a C file so that 32-bit instructions of its fast code begin at words: ``place.py GCC ... -o OBJECT -c C``.

A Cortex-M4 fetches aligned words. A 32-bit instruction across two of them may wait for the second: where floating-point
instructions follow each other, as the third of three behind a slow one, as the target of a branch. A 16-bit instruction
that is given its 32-bit form does the same in the same time, and moves all that follows by half a word.
"""

from __future__ import annotations

import math
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SECTION = ".fast_code"
# Those whose 32-bit form does the same. MULS has none that sets the flags; IT, CBZ and branches to registers have none.
WIDENED = re.compile(
    r"(adcs?|adds?|adr|ands?|asrs?|b|bics?|cmn|cmp|cpy|eors?|ldm|ldmia|ldmfd|ldrs?[bh]?|lsls?|lsrs?|movs?|mvns?|negs?|"
    r"nop|orrs?|pop|push|rev|rev16|revsh|rors?|rsbs?|sbcs?|stm|stmia|str[bh]?|subs?|sxtb|sxth|tst|uxtb|uxth)"
    r"(eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?"
)
_INSTRUCTION = re.compile(r"(\s+)([a-z][a-z0-9]*)((?:\.[a-z0-9]+)*)(\s.*|$)")
_BRANCH = re.compile(r"\s+b\w*\s+(\.L\w+)")
_ALIGNS = re.compile(r"\s*\.(?:p2align|balign|align)\b")
_OF_SECTION = re.compile(r"\s*\.(?:(push|pop)?section\b\s*([^\s,]*)|(text|data|bss)\b)")
_LISTED = re.compile(r" *(\d+) [0-9a-f]{4,} ([0-9A-F]+)\s")  # line and bytes, as the assembler lists them
PASSES = 8  # branches grow with what they pass over, so what lay well may lie badly again
# What it costs that an instruction straddles two words, and, far less, two bytes more.
STRADDLES = {True: 100, False: 30}  # floating point or not
TURNS = 8  # of a loop, for want of knowing better
WIDER = 1

Places = frozenset[int]


@dataclass(frozen=True)
class Way:
    """What led to one place in the code: its cost, and the lines widened, last one first."""

    cost: float = 0
    widened: tuple[int, Way | None] | None = None

    def plus(self, cost: float, line: int | None = None) -> Way:
        return Way(self.cost + cost, self.widened if line is None else (line, self))

    def lines(self) -> Iterator[int]:
        way: Way | None = self
        while way and way.widened:
            yield way.widened[0]
            way = way.widened[1]


NO_WAY = Way(math.inf)


def _cost(way: Way) -> float:
    return way.cost


def main(command: list[str]) -> int:
    """Compile to assembly, place the instructions, assemble."""
    target = Path(command[command.index("-o") + 1])
    assembly = target.with_suffix(".s")
    compiled = [str(assembly) if part == str(target) else "-S" if part == "-c" else part for part in command]
    done = subprocess.run(compiled, check=False)
    if done.returncode == 0:
        machine = [part for part in command if part.startswith("-m")]
        place(assembly, [command[0], *machine, "-c", str(assembly), "-o", str(target)])
    return done.returncode


def place(assembly: Path, assemble: list[str]) -> None:
    """Assemble a file, with those instructions of its fast code widened that put most others at words."""
    lines = assembly.read_text().splitlines()
    instructions = fast_code(lines)
    turns = turns_of(lines)
    widened: Places = frozenset()
    for _ in range(PASSES):
        _write(assembly, lines, widened)
        before, widened = widened, choose(instructions, turns, listing(assemble), widened)
        if widened == before:
            return
    _write(assembly, lines, widened)
    listing(assemble)


def _write(assembly: Path, lines: list[str], widened: Places) -> None:
    text = "\n".join(_widened(text) if line in widened else text for line, text in enumerate(lines))
    assembly.write_text(f"{text}\n")


def _widened(text: str) -> str:
    return _INSTRUCTION.sub(r"\1\2.w\4", text, count=1)


def fast_code(lines: list[str]) -> dict[int, str]:
    """Return the name of each instruction of the fast code by its line, and "" where a line aligns what follows."""
    sections, found = [".text"], {}
    for line, text in enumerate(lines):
        if directive := _OF_SECTION.match(text):
            sections = _after(sections, directive)
        elif sections[-1] == SECTION:
            if instruction := _INSTRUCTION.fullmatch(text):
                found[line] = instruction[2]
            elif _ALIGNS.match(text):
                found[line] = ""
    return found


def _after(sections: list[str], directive: re.Match[str]) -> list[str]:
    """Return the open sections after a directive."""
    if directive[1] == "pop":
        return sections[:-1]
    return [*(sections if directive[1] == "push" else sections[:-1]), directive[2] or f".{directive[3]}"]


def listing(assemble: list[str]) -> dict[int, int]:
    """Assemble; return the size [bytes] of what each line makes."""
    done = subprocess.run([*assemble, "-Wa,-aln"], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(done.stderr)
    found: dict[int, int] = {}
    for line in done.stdout.splitlines():
        if listed := _LISTED.match(line):
            found.setdefault(int(listed[1]) - 1, len(listed[2]) // 2)
    return found


def turns_of(lines: list[str]) -> list[int]:
    """Return how often each line runs for one time that its function does, as the branches back let expect."""
    labels = {text[:-1]: line for line, text in enumerate(lines) if text.endswith(":")}
    turns = [1] * len(lines)
    for line, text in enumerate(lines):
        if (branch := _BRANCH.fullmatch(text)) and (begin := labels.get(branch[1], line)) < line:
            turns[begin:line] = [TURNS * each for each in turns[begin:line]]
    return turns


def choose(instructions: dict[int, str], turns: list[int], sizes: dict[int, int], widened: Places) -> Places:
    """Return the lines to widen: of all ways through the code, the one with the fewest and cheapest straddles."""
    at_word, at_half = Way(), NO_WAY
    followed_by = [*list(instructions.values())[1:], ""]
    for (line, name), following in zip(instructions.items(), followed_by, strict=False):
        if not name:
            at_word, at_half = min(at_word, at_half, key=_cost), NO_WAY
        elif line not in sizes:
            continue
        elif sizes[line] == 4 and line not in widened:
            at_half = at_half.plus(turns[line] * STRADDLES[name.startswith("v")])
        elif WIDENED.fullmatch(name) and not following.startswith("it"):  # an IT is folded with 16 bits before it
            wide = at_word.plus(WIDER, line), at_half.plus(WIDER + turns[line] * STRADDLES[False], line)
            at_word, at_half = min(wide[0], at_half, key=_cost), min(wide[1], at_word, key=_cost)
        else:
            at_word, at_half = at_half, at_word
    return frozenset(min(at_word, at_half, key=_cost).lines())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
