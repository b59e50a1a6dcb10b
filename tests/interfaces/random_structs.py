"""Random C variables with random values, and what every path into them must read."""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass, field

_INTEGERS = {
    "int8_t": -8,
    "uint8_t": 8,
    "int16_t": -16,
    "uint16_t": 16,
    "int32_t": -32,
    "uint32_t": 32,
    "int64_t": -64,
    "uint64_t": 64,
    "char": 8,
    "signed char": -8,
    "unsigned": 32,
    "long": -32,
    "long long": -64,
}
_QUALIFIERS = ("", "", "const ", "volatile ", "const volatile ")
_DEEPEST = 3


@dataclass
class Written:
    """A declared thing: its declaration, its initialiser, and the values by what is written behind its name."""

    declaration: str
    initialiser: str
    values: dict[str, tuple[float, ...]]
    numbers: tuple[float, ...] | None  # of the whole; None where it is more than numbers


@dataclass
class Program:
    """A program of random variables, made from a seed; `values` are by path."""

    seed: int
    count: int
    values: dict[str, tuple[float, ...]] = field(default_factory=dict)
    before: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        lines = ["#include <stdbool.h>", "#include <stdint.h>"]
        for number in range(self.count):
            name = f"variable_{number}"
            result = self.thing(name, 0)
            lines += [*self.before, f"{result.declaration} = {result.initialiser};"]
            self.before.clear()
            self.values |= {name + behind: values for behind, values in result.values.items()}
            if result.numbers is not None:
                self.values[name] = result.numbers
        stored = "\n".join(
            f'    __asm volatile("" :: "r"(&variable_{index}) : "memory");' for index in range(self.count)
        )
        self.source = "\n".join([*lines, "int main(void)\n{", stored, "    for (;;);\n}"])

    def thing(self, name: str, depth: int) -> Written:
        """Make a number, an enum, an array, a pointer, a struct or a union."""
        makers = [self.number, self.number, self.enum]
        if depth < _DEEPEST:
            makers += [self.array, self.structure, self.structure, self.union, self.pointer]
        return self.random.choice(makers)(name, depth)

    def number(self, name: str, _depth: int) -> Written:
        qualifier = self.random.choice(_QUALIFIERS)
        kind = self.random.choice(["float", "double", "bool", *_INTEGERS])
        value, written = self.value(kind)
        return Written(f"{qualifier}{kind} {name}", written, {"": (value,)}, (value,))

    def value(self, kind: str) -> tuple[float, str]:
        if kind == "bool":
            truth = self.random.random() < 0.5
            return int(truth), str(truth).lower()
        if kind in ("float", "double"):
            real = self.random.uniform(-1, 1) * 10 ** self.random.uniform(-6, 6)
            if kind == "float":
                (real,) = struct.unpack("<f", struct.pack("<f", real))
            return real, f"{real.hex()}{'f' if kind == 'float' else ''}"
        bits = _INTEGERS[kind]
        low, high = (0, (1 << bits) - 1) if bits > 0 else (-(1 << -bits - 1), (1 << -bits - 1) - 1)
        number = self.random.choice([low, high, self.random.randint(low, high)])
        return number, f"{number}ull" if bits > 0 else f"({number + 1}ll - 1)" if number < 0 else f"{number}ll"

    def enum(self, name: str, _depth: int) -> Written:
        low = self.random.choice([-40000, -100, 0])
        values = sorted({0, 1, *(self.random.randint(low, 70000) for _ in range(4))})
        labels = ", ".join(f"{name}_E{number} = {value}" for number, value in enumerate(values))
        chosen = self.random.randrange(len(values))
        self.before.append(f"enum {name}_enum {{ {labels} }};")
        one = (float(values[chosen]),)
        return Written(f"enum {name}_enum {name}", f"{name}_E{chosen}", {"": one}, one)

    def array(self, name: str, depth: int) -> Written:
        counts = [self.random.randint(1, 3) for _ in range(self.random.randint(1, 2))]
        kind = self.random.choice(["float", "double", "bool", *_INTEGERS])
        if self.random.random() < 0.5:  # of numbers, of any dimensions
            dimensions = "".join(f"[{count}]" for count in counts)
            values, written = self.nested(kind, counts)
            numbers = tuple(number for value in values.values() for number in value)
            return Written(f"{kind} {name}{dimensions}", written, values, numbers)
        element = self.structure(f"{name}_e", depth)
        return self.repeated(name, element, counts[0])

    def repeated(self, name: str, element: Written, count: int) -> Written:
        """Make an array of structs with the same values in each."""
        kind = element.declaration.rpartition(" ")[0]
        values = {f"[{n}]{behind}": value for n in range(count) for behind, value in element.values.items()}
        whole = None if element.numbers is None else element.numbers * count
        written = "{ " + ", ".join([element.initialiser] * count) + " }"
        return Written(f"{kind} {name}[{count}]", written, values, whole)

    def nested(self, kind: str, counts: list[int]) -> tuple[dict[str, tuple[float, ...]], str]:
        if not counts:
            value, written = self.value(kind)
            return {"": (value,)}, written
        values: dict[str, tuple[float, ...]] = {}
        parts = []
        for index in range(counts[0]):
            inner, written = self.nested(kind, counts[1:])
            values |= {f"[{index}]{behind}": item for behind, item in inner.items()}
            parts.append(written)
        return values, "{ " + ", ".join(parts) + " }"

    def structure(self, name: str, depth: int) -> Written:
        values: dict[str, tuple[float, ...]] = {}
        numbers: tuple[float, ...] | None = ()
        members, initialisers = [], []
        for number in range(self.random.randint(1, 5)):
            anonymous = depth + 1 < _DEEPEST and self.random.random() < 0.15
            make = self.structure if anonymous else self.bit_field if self.random.random() < 0.3 else self.thing
            result = make(f"{name}_{number}", depth + 1)
            members.append(result.declaration.rpartition(" ")[0] if anonymous else result.declaration)
            initialisers.append(result.initialiser)
            before = "" if anonymous else f".{name}_{number}"
            values |= {before + behind: value for behind, value in result.values.items() if before + behind}
            if not anonymous and result.numbers is not None:
                values[before] = result.numbers
            numbers = None if numbers is None or result.numbers is None else numbers + result.numbers
        packed = self.random.choice(["", "", "__attribute__((packed)) "])
        body = f"struct {packed}{{ {'; '.join(members)}; }} {name}"
        return Written(body, "{ " + ", ".join(initialisers) + " }", values, numbers)

    def bit_field(self, name: str, _depth: int) -> Written:
        kind = self.random.choice([item for item in _INTEGERS if item != "long"])
        width = self.random.randint(1, abs(_INTEGERS[kind]))
        signed = _INTEGERS[kind] < 0
        low, high = (-(1 << width - 1), (1 << width - 1) - 1) if signed else (0, (1 << width) - 1)
        value = self.random.choice([low, high, self.random.randint(low, high)])
        written = f"({value + 1}ll - 1)" if value < 0 else f"{value}ull"
        return Written(f"{kind} {name} : {width}", written, {"": (value,)}, (value,))

    def union(self, name: str, depth: int) -> Written:
        result = self.number(f"{name}_u", depth)
        body = f"union {{ {result.declaration}; uint8_t {name}_bytes[8]; }} {name}"
        return Written(body, f"{{ {result.initialiser} }}", {f".{name}_u": result.numbers or ()}, None)

    def pointer(self, name: str, depth: int) -> Written:
        target = self.structure(f"{name}_target", depth)
        kind = f"{name}_type"
        body = target.declaration.rpartition(" ")[0]
        self.before += [f"typedef {body} {kind};", f"{kind} {name}_target = {target.initialiser};"]
        values = {
            f"->{behind[1:]}" if behind[0] == "." else behind: value
            for behind, value in target.values.items()
            if behind[0] == "."
        }
        values |= {f"[0]{behind}": value for behind, value in target.values.items()}
        return Written(f"{kind} *{name}", f"&{name}_target", values, None)
