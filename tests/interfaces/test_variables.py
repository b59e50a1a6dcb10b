"""Values by their path in the debug information: where they lie, what the bytes mean, and why there is none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.interfaces.places import NullPointer
from hiltest.interfaces.variables import Variables, function_address
from hiltest.virtual.program.elf import FirmwareImage, load_image

from ..foreign_elf import foreign_elf
from .compiled import InitialMemory, compile_c

SOURCE = """
#include <stdbool.h>
#include <stdint.h>

enum axis { AXIS_X, AXIS_Y, AXIS_Z };
enum level { COLD = -3, WARM = 5 };
typedef enum { NONE, FOUR = 4, SEVEN = 7, TEN = 10 } solver_t;
#define CHX 0

typedef float vector_t[3];
typedef struct { float x, y, z; } xyz_t;
struct node { int16_t value; const struct node *next; };

struct calibration {
    vector_t hard_iron;
    float inverse[3][3];
    volatile solver_t solver;
    const double strength;
    bool valid : 1;
    unsigned int quality : 5;
    int trend : 4;
    uint64_t wide : 37;
    union { uint32_t word; uint8_t bytes[4]; };
    union { int16_t half; int8_t quarter; } choice;
};

struct calibration calibration = {
    { 11.5f, -16.25f, 10.0f }, { { 1, 2, 3 }, { 4, 5, 6 }, { 7, 8, 9 } }, SEVEN, 47.125,
    true, 21, -5, 0x1234567890ull, { 0xA1B2C3D4u }, { -2 },
};
struct { struct { struct calibration *current; xyz_t rates; } part[2]; } app = {
    { { &calibration, { -1.5f, 0.25f, 3 } }, { 0, { 4, 5, 6 } } },
};
static const struct node third = { 30, 0 }, second = { -20, &third };
struct node first = { 10, &second };
xyz_t samples[4] = { { 1, 2, 3 }, { 4, 5, 6 }, { 7, 8, 9 }, { 10, 11, 12 } };
xyz_t *latest = &samples[2];
xyz_t **handle = &latest;
int (*row)[2];
void *anything = &first;
volatile enum level level = COLD;
int64_t before = -9000000000000000000ll;
uint64_t after = 18000000000000000000ull;
char letter = 'A';
signed char small = -100;
unsigned char byte = 200;
int8_t numbers[] = { -1, 2, -3 };
volatile int state, calls;
volatile enum axis axis = AXIS_X;
float matrix[2][3] = { { 1, 2, 3 }, { 4, 5, 6 } };
void (*handler)(void);

__attribute__((noinline)) int sample(void)
{
    static volatile int count = 7;
    return ++count;
}

#define KEPT(variable) __asm volatile("" :: "r"(&variable) : "memory")

int main(void)
{
    KEPT(calibration); KEPT(app); KEPT(first); KEPT(samples); KEPT(handle); KEPT(row); KEPT(anything); KEPT(before);
    KEPT(after); KEPT(letter); KEPT(small); KEPT(byte); KEPT(numbers); KEPT(matrix); KEPT(handler); KEPT(third);
    KEPT(latest);
    for (;;)
        calls += sample() + state + (int)level;
}
"""

VALUES: dict[str, tuple[float, ...]] = {
    "calibration.hard_iron": (11.5, -16.25, 10.0),
    "calibration.hard_iron[1]": (-16.25,),
    "calibration.hard_iron[AXIS_Z]": (10.0,),
    "calibration.inverse": (1, 2, 3, 4, 5, 6, 7, 8, 9),
    "calibration.inverse[1]": (4, 5, 6),
    "calibration.inverse[2][0]": (7,),
    "calibration.solver": (7,),
    "calibration.strength": (47.125,),
    "calibration.valid": (1,),
    "calibration.quality": (21,),
    "calibration.trend": (-5,),
    "calibration.wide": (0x1234567890,),
    "calibration.word": (0xA1B2C3D4,),
    "calibration.bytes": (0xD4, 0xC3, 0xB2, 0xA1),
    "calibration.bytes[0x3]": (0xA1,),
    "calibration.choice.half": (-2,),
    "calibration.choice.quarter": (-2,),
    "app.part[0].current->hard_iron[0]": (11.5,),
    "app.part[AXIS_X].current[0].trend": (-5,),
    "app.part[1].rates": (4, 5, 6),
    "app.part[0].rates.y": (0.25,),
    "first.next->value": (-20,),
    "first.next->next->value": (30,),
    "program.c:third.value": (30,),
    "*latest": (7, 8, 9),
    "latest->y": (8,),
    "latest[1]": (10, 11, 12),
    "latest[-2].x": (1,),
    "**handle": (7, 8, 9),
    "handle[0]->z": (9,),
    "*samples": (1, 2, 3),
    "samples": tuple(range(1, 13)),
    " * latest": (7, 8, 9),
    "samples [ 1 ] . z": (6,),
    "level": (-3,),
    "before": (-9000000000000000000,),
    "after": (18000000000000000000,),
    "letter": (65,),
    "small": (-100,),
    "byte": (200,),
    "numbers": (-1, 2, -3),
    "matrix": (1, 2, 3, 4, 5, 6),
    "matrix[1]": (4, 5, 6),
    "*matrix": (1, 2, 3),
    "sample::count": (7,),
    "program.c:sample::count": (7,),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("variables")


@pytest.fixture(
    scope="module",
    params=[
        "-gdwarf-5 -O0",
        "-gdwarf-4 -O2",
        "-gdwarf-3 -O1",
        "-gdwarf-2 -gstrict-dwarf",
        "-gdwarf-5 -O2 -flto",
        "-gdwarf-4 -O2 -fdebug-types-section",
        "-g3 -Os -fdata-sections -gz",
    ],
)
def image(request: pytest.FixtureRequest, folder: Path, require_tool: Callable[[str], str]) -> FirmwareImage:
    """The program, with debug information of every version."""
    place = folder / request.param.replace(" ", "")
    place.mkdir()
    return load_image(compile_c(require_tool("arm-none-eabi-gcc"), place, SOURCE, *request.param.split()))


@pytest.fixture(scope="module")
def plain(folder: Path, require_tool: Callable[[str], str]) -> FirmwareImage:
    place = folder / "plain"
    place.mkdir()
    return load_image(compile_c(require_tool("arm-none-eabi-gcc"), place, SOURCE))


def test_every_path_reads_what_the_program_begins_with(image: FirmwareImage) -> None:
    variables, memory = Variables(image), InitialMemory(image)
    read = {}
    for path in VALUES:
        place = variables.place(path)
        read[path] = place.numbers(place.read(memory))
    assert read == VALUES


def test_an_enum_is_shown_with_the_name_of_its_value(plain: FirmwareImage) -> None:
    memory = InitialMemory(plain)
    shown = {}
    for path in ("calibration.solver", "level", "calibration.hard_iron"):
        place = Variables(plain).place(path)
        shown[path] = place.shown(place.read(memory))
    assert shown == {
        "calibration.solver": "SEVEN (7)",
        "level": "COLD (-3)",
        "calibration.hard_iron": "11.5, -16.25, 10",
    }


def test_pointers_are_followed_anew_each_time_and_one_that_is_0_is_named(plain: FirmwareImage) -> None:
    place = Variables(plain).place("app.part[1].current->hard_iron")
    initial = InitialMemory(plain)
    with pytest.raises(NullPointer, match=r"app\.part\[1\]\.current->hard_iron: the pointer at 0x2"):
        place.read(initial)
    target = plain.symbols["calibration"].address.to_bytes(4, "little")
    written = {place.address: target}
    data = place.read(lambda address, size: written.get(address) or initial(address, size))
    assert place.numbers(data) == (11.5, -16.25, 10.0)


REFUSED = {
    "calibration.hard_irno": "struct calibration has no member hard_irno; nearest: hard_iron",
    "calibration.Valid": "has no member Valid; nearest: valid",
    "calibraton.valid": "no variable calibraton; nearest: calibration",
    "calibration": "calibration is union without a name, a union: name a member of it (word, bytes)",
    "calibration.choice": "a union: name a member of it (half, quarter)",
    "calibration.hard_iron[3]": "has the elements 0 to 2",
    "calibration.hard_iron[-1]": "has the elements 0 to 2",
    "calibration.hard_iron[CHX]": "no enum has CHX; macros ",
    "calibration.valid[0]": "not an array",
    "calibration->valid": "is struct calibration, not a pointer; write calibration.valid",
    "calibration.valid.x": "not a struct: it has no x",
    "app.part.rates": "name an element, app.part[0].rates",
    "app.part[0].current.trend": "a pointer; write app.part[0].current->trend",
    "app.part[0].current": "a pointer: name its target, app.part[0].current->hard_iron",
    "latest": "xyz_t *, a pointer: name its target, latest->x",
    "handle": "xyz_t * *, a pointer: name its target, *handle or handle[0]",
    "anything": "void *, a pointer",
    "*level": "not a pointer; leave out the *",
    "*anything": "its target type is unknown",
    "*handler": "which has no value to read",
    "other.c:calibration": "calibration is not in other.c, but in ",
    "count": "count is within a function; write sample::count",
    "": "is not a path to a variable",
    "calibration.": "'.' cannot be parsed",
    "calibration.valid + 1": "' + 1' cannot be parsed",
    "(*latest).x": "is not a path to a variable",
    "&calibration": "is not a path to a variable",
    "x" * 2000: "is not a path to a variable",
}


@pytest.mark.parametrize("path", REFUSED)
def test_a_path_that_leads_nowhere_is_refused_with_the_next_step(plain: FirmwareImage, path: str) -> None:
    with pytest.raises(ConfigError) as refused:
        Variables(plain).place(path)
    assert any(part in str(refused.value) for part in REFUSED[path].split("|"))


def test_statics_of_one_name_are_refused_with_their_places_unless_the_file_is_named(
    tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    (tmp_path / "mag").mkdir()
    elf = compile_c(
        require_tool("arm-none-eabi-gcc"),
        tmp_path,
        {
            "a.c": "static volatile int last = 1; __attribute__((noinline)) static int step(void) { return last; }\n"
            "int other(void); int main(void) { for (;;) last = step() + other(); }",
            "mag/b.c": "static volatile int last = 2;\n"
            "__attribute__((noinline)) static int step(void) { return last; }\n"
            "int other(void) { return step(); }",
        },
    )
    image = load_image(elf)
    variables, memory = Variables(image), InitialMemory(image)
    with pytest.raises(
        ConfigError, match=r"2 variables are called last: .*a\.c \(0x2\w+\), .*b\.c \(0x2\w+\); select one"
    ):
        variables.place("last")
    for path, value in {"a.c:last": 1, "b.c:last": 2, "mag/b.c:last": 2}.items():
        place = variables.place(path)
        assert place.numbers(place.read(memory)) == (value,)
    with pytest.raises(ConfigError, match=r"last is not in c\.c"):
        variables.place("c.c:last")
    with pytest.raises(ConfigError, match=r"step is in a\.c \(0x\w+\), b\.c \(0x\w+\); select one"):
        function_address(image, "step")
    assert {function_address(image, "a.c:step"), function_address(image, "b.c:step")} == {
        function.address for function in image.functions if function.name == "step"
    }
    with pytest.raises(ConfigError, match="no function stap; nearest: step"):
        function_address(image, "stap")


GONE = """
#include <stdint.h>
static int doubled;
static const float scale = 2.5f;
static int unused_table[4] = { 1, 2, 3, 4 };
extern int elsewhere;
__thread int each_thread;
register int held __asm("r9");
struct opaque *hidden;
struct late;
struct late *known;
volatile float kept;
int used_by_nobody = 5;
int *where(void) { return &elsewhere; }
int main(void)
{
    doubled = 2;
    for (;;)
        kept += scale * (float)doubled + (float)held + (hidden != 0) + (known != 0);
}
"""


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("doubled", "the compiler has optimised it away; declare it volatile|uses its constant value in the code"),
        ("scale", "the compiler uses its constant value in the code|optimised it away"),
        ("each_thread", "each_thread is thread-local: each thread has its own"),
        ("held", "held is in a register only"),
        ("elsewhere", "elsewhere is declared, but not defined in this firmware"),
        ("used_by_nobody", "the linker removed it as unused"),
        ("hidden->x", "this firmware has no definition of struct opaque, only its name"),
        ("hidden[1]", "the size of struct opaque is not known"),
    ],
)
def test_what_lies_nowhere_in_memory_is_refused_with_the_reason(
    path: str, reason: str, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    elf = compile_c(
        require_tool("arm-none-eabi-gcc"),
        tmp_path,
        GONE,
        "-O2",
        "-fdata-sections",
        "-ffunction-sections",
        "-Wl,--gc-sections",
    )
    with pytest.raises(ConfigError) as refused:
        Variables(load_image(elf)).place(path)
    assert any(part in str(refused.value) for part in reason.split("|"))


def test_a_struct_that_one_file_only_declares_is_read_where_another_defines_it(
    tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    elf = compile_c(
        require_tool("arm-none-eabi-gcc"),
        tmp_path,
        {
            "a.c": "struct late; extern struct late late; struct late *known = &late;\n"
            "int main(void) { for (;;) *(struct late *volatile *)&known; }",
            "b.c": "struct late { int a; short b; } late = { 1, -7 };",
        },
    )
    image = load_image(elf)
    place = Variables(image).place("known->b")
    assert place.numbers(place.read(InitialMemory(image))) == (-7,)


CPP = """
namespace nav {
namespace filter {
volatile float heading = 1.5f;
struct Base { int first = 3; };
struct State : Base { float gains[2] = { 1, 2 }; static int count; };
State state;
}
static volatile int ticks = 9;
}
int nav::filter::State::count = 4;
namespace { volatile int hidden = 5; }
enum class Axis : unsigned char { X, Y, Z };
volatile Axis axis = Axis::Y;
template <typename T> struct Vector { T v[3]; };
Vector<float> field = {{ 1, 2, 3 }};
struct Compass { nav::filter::State &state; } compass = { nav::filter::state };
extern "C" int main()
{
    for (;;) {
        __asm volatile("" :: "r"(&compass), "r"(&field), "r"(&nav::filter::State::count), "r"(&axis) : "memory");
        nav::ticks = nav::ticks + hidden;
    }
}
"""


@pytest.mark.parametrize("version", ["-gdwarf-4", "-gdwarf-5", "-gdwarf-4 -fdebug-types-section"])
def test_variables_of_cpp_are_named_with_their_namespaces_and_classes(
    version: str, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    compiler = require_tool("arm-none-eabi-g++")
    image = load_image(compile_c(compiler, tmp_path, {"program.cpp": CPP}, *version.split(), "-fno-exceptions"))
    variables, memory = Variables(image), InitialMemory(image)
    expected = {
        "nav::filter::heading": (1.5,),
        "nav::filter::state": (3, 1, 2),
        "nav::filter::state.first": (3,),
        "nav::filter::State::count": (4,),
        "nav::ticks": (9,),
        "hidden": (5,),
        "axis": (1,),
        "field.v": (1, 2, 3),
        "field.v[Z]": (3,),
        "compass.state->gains": (1, 2),
    }
    read = {}
    for path in expected:
        place = variables.place(path)
        read[path] = place.numbers(place.read(memory))
    assert read == expected
    with pytest.raises(ConfigError, match="no variable heading; nearest: nav::filter::heading"):
        variables.place("heading")


def test_without_debug_information_a_symbol_is_read_by_the_type_that_the_rig_states(
    tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    image = load_image(compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, SOURCE, "-g0"))
    variables, memory = Variables(image), InitialMemory(image)
    stated = {
        ("matrix", "float[2][3]"): (1, 2, 3, 4, 5, 6),
        ("matrix[1]", "float[2][3]"): (4, 5, 6),
        ("matrix[1][2]", "float [2] [3]"): (6,),
        ("numbers", "int8_t[3]"): (-1, 2, -3),
        ("after", "uint64"): (18000000000000000000,),
        ("byte", "uint8_t"): (200,),
    }
    for (path, kind), values in stated.items():
        place = variables.place(path, type_=kind)
        assert place.numbers(place.read(memory)) == values
    with pytest.raises(ConfigError, match=r"no debug information about matrix, of 24 bytes; .* type = "):
        variables.place("matrix")
    with pytest.raises(ConfigError, match=r"float\[3\] has 12 bytes, and the symbol matrix has 24"):
        variables.place("matrix", type_="float[3]")
    with pytest.raises(ConfigError, match="no symbol matrx; nearest: matrix"):
        variables.place("matrx", type_="float[6]")
    for wrong in ("flaot[3]", "float[0]", "float[]", "int24", "float*", ""):
        with pytest.raises(ConfigError, match="is not known; write float"):
            variables.place("matrix", type_=wrong)


def test_paths_into_firmware_that_others_wrote_are_found_in_its_debug_information() -> None:
    variables = Variables(load_image(foreign_elf("nxp_sensor_fusion.elf")))
    assert [
        (len(variables.place(path).scalars), variables.place(path).type_text)
        for path in (
            "sfg.MagCal.fV",
            "sfg.MagCal.finvW",
            "sfg.SV_9DOF_GBY_KALMAN.fPhiPl",
            "sfg.pControlSubsystem->DefaultQuaternionPacketType",
        )
    ] == [(3, "float[3]"), (9, "float[3][3]"), (1, "float"), (1, "quaternion_type")]
