"""Tables that map foreign signatures: the same answers as with the contract, and each mistake with its place."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.judge.test_filters import motion

from hiltest.commands.cli import main
from hiltest.errors import BoardFault, ConfigError
from hiltest.judge.answers import Answer, rate
from hiltest.judge.build import header_folder
from hiltest.judge.entries import open_entry, open_filter, open_foreign
from hiltest.judge.filters import FilterAnswers, median_cycles
from hiltest.judge.foreign_entries import ForeignCalibrator, ForeignFilter
from hiltest.judge.host_calibrator import HostCalibrator
from hiltest.judge.signature_table import read_signature_table
from hiltest.judge.worlds import FAMILIES, World, draw_world

WORLDS = [draw_world(family, 3) for family in FAMILIES]
DOCS = Path(__file__).parents[2] / "docs" / "judge.md"
ANSWERS_DEG = 1e-6  # results are the same on every host to this
Write = Callable[[str, str], str]

# A filter as STM32 projects have it, from Mahony, Hamel and Pflimlin 2008: z up, deg/s, its state in a struct.
MAHONY_C = """
#include <math.h>

typedef struct {
    float q[4];
    float gain;
    struct { float roll, pitch, yaw; } angles;
} filter_t;

void MahonyInit(filter_t *filter, float gain)
{
    for (int i = 0; i < 4; i++)
        filter->q[i] = i == 0 ? 1.0f : 0.0f;
    filter->gain = gain;
}

void MahonyUpdate(filter_t *state, float gx, float gy, float gz, float ax, float ay, float az, float mx, float my,
                  float mz, float dt)
{
    float w = state->q[0], x = state->q[1], y = state->q[2], z = state->q[3];
    float n = 1.0f / sqrtf(ax * ax + ay * ay + az * az), m = 1.0f / sqrtf(mx * mx + my * my + mz * mz);
    float r[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                     {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                     {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    float a[3] = {ax * n, ay * n, az * n}, f[3] = {mx * m, my * m, mz * m}, h[3], e[3], v[3];
    for (int i = 0; i < 3; i++)
        h[i] = r[i][0] * f[0] + r[i][1] * f[1] + r[i][2] * f[2];
    float b = sqrtf(h[0] * h[0] + h[1] * h[1]);
    for (int i = 0; i < 3; i++)
        v[i] = b * r[0][i] + h[2] * r[2][i];
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        e[i] = a[j] * r[2][k] - a[k] * r[2][j] + f[j] * v[k] - f[k] * v[j];
    }
    float p = 0.5f * dt * (gx * 0.0174532925f + state->gain * e[0]);
    float q = 0.5f * dt * (gy * 0.0174532925f + state->gain * e[1]);
    float s = 0.5f * dt * (gz * 0.0174532925f + state->gain * e[2]);
    float next[4] = {w - x * p - y * q - z * s, x + w * p + y * s - z * q, y + w * q - x * s + z * p,
                     z + w * s + x * q - y * p};
    float norm = 1.0f / sqrtf(next[0] * next[0] + next[1] * next[1] + next[2] * next[2] + next[3] * next[3]);
    for (int i = 0; i < 4; i++)
        state->q[i] = next[i] * norm;
    state->angles.yaw = atan2f(2 * (x * y + w * z), 1 - 2 * (y * y + z * z));
}
"""
RANGE_TOML, QUATERNION_TOML = re.findall(r"```toml\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
MAHONY_TOML = QUATERNION_TOML.rpartition("quaternion")[0]
MAHONY_CONTRACT_C = (
    MAHONY_C
    + """
#include "hiltest_judge.h"

static filter_t filter;

void filter_init(float rate_hz)
{
    (void)rate_hz;
    MahonyInit(&filter, 2.0f);
}

void filter_update(const float g[3], const float a[3], const float m[3], float dt)
{
    const double deg = 57.29577951308232, gravity = 9.80665;
    MahonyUpdate(&filter, (float)(deg * g[0]), (float)(-deg * g[1]), (float)(-deg * g[2]),
                 (float)(-gravity * a[0]), (float)(gravity * a[1]), (float)(gravity * a[2]), 10.0f * m[0],
                 -10.0f * m[1], -10.0f * m[2], dt);
}

/* north, west, up of forward, left, up: half turns about x on both sides */
void filter_quaternion(float q[4])
{
    q[0] = filter.q[1];
    q[1] = -filter.q[2];
    q[2] = -filter.q[3];
    q[3] = filter.q[0];
}
"""
)

# Minimum and maximum of counts, with axes of the chip: x of the body is the chip's y, and y its -x.
RANGE_C = """
#include <stdint.h>

struct sample { uint32_t time_ms; int16_t x, y, z; uint8_t flags; };
typedef struct { float off[3]; float gain[3]; } cal_t;

int mag_cal(const struct sample *s, uint16_t n, cal_t *out)
{
    int low[3] = {32767, 32767, 32767}, high[3] = {-32768, -32768, -32768};
    for (int i = 0; i < n; i++) {
        const int16_t v[3] = {s[i].x, s[i].y, s[i].z};
        for (int k = 0; k < 3; k++) {
            low[k] = v[k] < low[k] ? v[k] : low[k];
            high[k] = v[k] > high[k] ? v[k] : high[k];
        }
    }
    for (int k = 0; k < 3; k++) {
        out->off[k] = 0.5f * (float)(low[k] + high[k]);
        out->gain[k] = 2.0f / (float)(high[k] - low[k]);
    }
    return n > 13;
}
"""
RANGE_CONTRACT_C = (
    RANGE_C
    + """
#include "hiltest_judge.h"
#include <math.h>

int calibrate(const float samples[][3], int n, float hard_iron[3], float soft_iron[3][3])
{
    static struct sample s[1000];
    cal_t out;
    for (int i = 0; i < n; i++) {
        s[i].x = (int16_t)lrintf(-10.0f * samples[i][1]);
        s[i].y = (int16_t)lrintf(10.0f * samples[i][0]);
        s[i].z = (int16_t)lrintf(10.0f * samples[i][2]);
    }
    int good = mag_cal(s, (uint16_t)n, &out);
    const float h[3] = {out.off[1], -out.off[0], out.off[2]}, w[3] = {out.gain[1], out.gain[0], out.gain[2]};
    for (int k = 0; k < 3; k++) {
        hard_iron[k] = h[k] / 10.0f;
        for (int j = 0; j < 3; j++)
            soft_iron[k][j] = j == k ? w[k] : 0.0f;
    }
    return !good;
}
"""
)
SIMPLE_TOML = """
calibrate = "fit(samples, count, &out)"
magnetometer = { path = "samples", unit = "uT" }
hard_iron = { path = "out", unit = "uT" }
"""


@pytest.fixture(autouse=True)
def compilers(require_tool: Callable[[str], str]) -> None:
    for tool in ("arm-none-eabi-gcc", "cc"):
        require_tool(tool)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Return a function that writes a file and returns its name."""

    def write_file(text: str, name: str) -> str:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return str(tmp_path / name)

    return write_file


def linked(source: str, *options: str) -> str:
    """Link a source as firmware of an STM32F4."""
    elf = str(Path(source).with_suffix(".elf"))
    command = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", *options, "-g", "-O2", "-nostartfiles"]
    command += ["--specs=nosys.specs", "-Wl,--no-warnings", "-Wl,-Ttext=0x08000000", "-Wl,-Tdata=0x20000000"]
    subprocess.run([*command, f"-I{header_folder()}", source, "-lm", "-o", elf], check=True, timeout=60)
    return elf


def library(source: str, *options: str) -> str:
    """Compile a source as a library of the host."""
    file = str(Path(source).with_suffix(".so"))
    subprocess.run(["cc", "-g", "-shared", "-fPIC", *options, source, "-lm", "-o", file], check=True, timeout=60)
    return file


def opened(named: str, table: str) -> AbstractContextManager[Any]:
    """Open the calibrator or filter of a table."""
    return open_foreign(named, read_signature_table(Path(table)))


def answer_of(named: str, table: str | None, world: World = WORLDS[0]) -> Answer:
    with opened(named, table) if table else open_entry(named, None) as entry:
        return entry.answer(world)


def filter_answers(named: str, table: str | None) -> FilterAnswers:
    with opened(named, table) if table else open_filter(named) as judged:
        return judged.follow(motion())


@pytest.mark.parametrize("floats", [("-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"), ("-mfloat-abi=soft",)])
def test_a_filter_of_firmware_is_judged_as_with_the_contract(write: Write, floats: tuple[str, ...]) -> None:
    elf, table = linked(write(MAHONY_C, "mahony.c"), *floats), write(QUATERNION_TOML, "mahony.toml")
    answers = filter_answers(elf, table)
    expected = filter_answers(linked(write(MAHONY_CONTRACT_C, "contract.c"), *floats), None)
    turns = [Rotation.from_quat(one.quaternions) for one in (answers, expected)]  # type: ignore[arg-type]
    assert np.degrees((turns[0].inv() * turns[1]).magnitude()).max() < ANSWERS_DEG
    assert median_cycles(answers.cycles) < median_cycles(expected.cycles), "the cycles are those of the function alone"


def test_quaternions_of_all_orders_and_directions_are_one_attitude(write: Write) -> None:
    source = write("float q[4]; void step(float rate) { q[0] += 0.0f * rate; }", "step.c")
    turn = Rotation.from_euler("zyx", [30.0, 20.0, 10.0], degrees=True)  # from y, -x, z to east, north, up
    expected = (
        np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ turn.as_matrix() @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]).T
    )
    for order, inverse in (("wxyz", "false"), ("xyzw", "true")):
        numbers = (turn.inv() if inverse == "true" else turn).as_quat()
        numbers = np.roll(numbers, 1) if order == "wxyz" else numbers
        constants = ", ".join(f'"q[{place}]" = {number}' for place, number in enumerate(numbers))
        table = f"""
        update = "step(0.0)"
        frame = "enu"
        axes = ["y", "-x", "z"]
        quaternion = {{ path = "q", order = "{order}", inverse = {inverse} }}
        constants = {{ {constants} }}
        """
        answers = filter_answers(source, write(table, f"{order}.toml"))
        matrix = Rotation.from_quat(answers.quaternions[0]).as_matrix()  # type: ignore[index]
        assert np.abs(matrix - expected).max() < 1e-6  # a float32


def test_a_heading_of_a_filter_has_its_own_unit_and_direction(write: Write) -> None:
    source = write(MAHONY_C, "mahony.c")
    table = write(MAHONY_TOML + 'heading = { path = "filter.angles.yaw", unit = "rad" }', "heading.toml")
    answers = filter_answers(source, table)
    expected = filter_answers(source, write(QUATERNION_TOML, "mahony.toml"))
    assert answers.headings_deg is not None
    assert expected.quaternions is not None
    x, y, z, w = expected.quaternions.T
    yaw = np.degrees(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))
    # The yaw is that of the last update, up to 0.9 deg before: 90 deg/s for 10 ms.
    assert np.abs((answers.headings_deg - yaw + 180) % 360 - 180).max() < 1.0


def test_a_calibrator_of_structs_of_counts_is_judged_as_with_the_contract(write: Write, tmp_path: Path) -> None:
    elf, table = linked(write(RANGE_C, "range.c")), write(RANGE_TOML, "range.toml")
    contract = write(RANGE_CONTRACT_C, "contract.c")
    shared = library(write(RANGE_C, "shared.c"))
    with (
        opened(elf, table) as entry,
        open_entry(contract, None) as other,
        opened(shared, table) as host,
    ):
        assert isinstance(entry, ForeignCalibrator)
        assert isinstance(host, HostCalibrator)
        for world in WORLDS:
            answer, same, on_host = (one.answer(world) for one in (entry, other, host))
            for foreign in (answer, on_host):
                rounded = replace(foreign, hard_iron_ut=foreign.hard_iron_ut.astype(np.float32))  # as in the contract
                assert rate(rounded, world).rms_deg == pytest.approx(rate(same, world).rms_deg, abs=ANSWERS_DEG)
            assert answer.refused == same.refused == on_host.refused == (len(world.samples_ut) <= 13)
            assert answer.cycles is not None
            assert answer.cycles < (same.cycles or 0)
    assert on_host.host_us is not None


RANGES = """
#include <stdint.h>
#define RANGE(value) low = high = 0; for (int i = 0; i < count; i++) { \\
    low = i == 0 || value < low ? value : low; high = i == 0 || value > high ? value : high; }
"""


@pytest.mark.parametrize(
    ("text", "table"),
    [
        pytest.param(
            """
            void fit(const double *x, const double *y, const double *z, int count, double *bias)
            {
                const double *v[3] = {x, y, z};
                double low, high;
                for (int k = 0; k < 3; k++) { RANGE(v[k][i]) bias[k] = 0.5e-6 * (low + high); }
            }
            """,
            """
            calibrate = "fit(x, y, z, count, bias)"
            magnetometer = { path = ["x", "y", "z"], unit = "nT" }
            hard_iron = { path = "bias", unit = "uT", scale = 1e3 }
            """,
            id="three arrays",
        ),
        pytest.param(
            """
            struct result { int valid; float bias[3], rest[9]; };
            static struct result result;
            const struct result *fit(const int32_t *v, uint8_t count, float work[][2])
            {
                float low, high;
                for (int k = 0; k < 3; k++) {
                    RANGE(v[3 * i + k])
                    work[k][1] = 0.5f * (low + high);
                    result.bias[k] = work[k][1];
                }
                return &result;
            }
            """,
            """
            calibrate = "fit(v, count, work[3])"
            success = "always"
            magnetometer = { path = "v", unit = "uT", scale = 0.01 }
            hard_iron = { path = "return->bias", unit = "uT", scale = 0.01 }
            """,
            id="flat array and returned pointer",
        ),
        pytest.param(
            """
            struct vector { float x, y, z; };
            static struct { int used; struct vector of[100]; } buffer;
            static volatile int samples_used;
            float matrix[3][3], offset[3];
            void fit(void)
            {
                float low, high;
                int count = samples_used;
                const float *v = &buffer.of[0].x;
                for (int k = 0; k < 3; k++) {
                    for (int j = 0; j < 3; j++)
                        matrix[j][k] = j == k ? 2.0f : k == 2 ? 0.5f : 0.0f;
                }
                float middle[3];
                for (int k = 0; k < 3; k++) { RANGE(v[3 * i + k]) middle[k] = 0.5f * (low + high); }
                for (int k = 0; k < 3; k++)
                    offset[k] = middle[0] * matrix[k][0] + middle[1] * matrix[k][1] + middle[2] * matrix[k][2];
            }
            """,
            """
            calibrate = "fit()"
            magnetometer = { path = "buffer.of[i]", unit = "gauss" }
            count = { path = "samples_used" }
            hard_iron = { path = "offset", unit = "G", subtracted = "after" }
            soft_iron = { path = "matrix" }
            """,
            id="global variables",
        ),
        pytest.param(
            """
            typedef struct { double low[3], high[3], number; } state_t;
            void reset(state_t *s, double first) { s->low[0] = first; }
            void add(state_t *s, const float v[3])
            {
                for (int k = 0; k < 3; k++) {
                    s->low[k] = s->number == 0 || v[k] < s->low[k] ? v[k] : s->low[k];
                    s->high[k] = s->number == 0 || v[k] > s->high[k] ? v[k] : s->high[k];
                }
                s->number += 1;
            }
            int8_t solve(const state_t *s, float *x, float *y, float *z, void *unused)
            {
                *x = (s->low[0] + s->high[0]) / 2, *y = (s->low[1] + s->high[1]) / 2, *z = (s->low[2] + s->high[2]) / 2;
                return unused ? -1 : (int8_t)s->number;
            }
            """,
            """
            start = "reset(&s, 0)"
            add = "add(&s, v)"
            calibrate = "solve(&s, &x, &y, &z, NULL)"
            success = "not negative"
            magnetometer = { path = "v", unit = "mT" }
            hard_iron = { path = ["x", "y", "z"], unit = "mT" }
            """,
            id="one sample a call",
        ),
    ],
)
def test_samples_and_results_may_lie_anywhere(write: Write, text: str, table: str) -> None:
    source, signature = write(RANGES + text, "any.c"), write(table, "any.toml")
    samples = WORLDS[0].samples_ut
    middle = 0.5 * (samples.min(axis=0) + samples.max(axis=0))
    for file in [source] if "return->" in table else [source, library(source)]:
        with opened(file, signature) as entry:
            entry.answer(WORLDS[1])
            answer = entry.answer(WORLDS[0])
        # float32 of 50 uT after a product, and halves of steps of 0.01 uT
        assert np.abs(answer.hard_iron_ut - middle).max() < 1e-4
        assert not answer.refused
        assert file != source or (answer.cycles or 0) > 1000


def test_forms_of_a_soft_iron_are_the_same_matrix(write: Write) -> None:
    matrix = np.array([[1.0, 0.1, 0.2], [0.1, 0.9, 0.3], [0.2, 0.3, 1.1]])
    skewed = matrix + np.array([[0.0, 0.05, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    cases = [
        (matrix, matrix[np.triu_indices(3)], 'form = "symmetric"'),
        (skewed, skewed.ravel(), ""),
        (skewed, skewed.T.ravel(), 'order = "columns"'),
        (np.linalg.inv(skewed), skewed.ravel(), "inverse = true"),
        (np.diag([2.0, 0.5, 4.0]), np.array([0.5, 2.0, 0.25]), 'form = "gains", inverse = true'),
    ]
    for expected, numbers, keys in cases:
        listed = ", ".join(f"{number!r}" for number in map(float, numbers))
        text = "void fit(const float (*samples)[3], int count, float out[3]) { out[0] = w[0]; }"
        table = SIMPLE_TOML.replace("&out", "out") + f'soft_iron = {{ path = "w"{", " if keys else ""}{keys} }}\n'
        answer = answer_of(write(f"double w[] = {{{listed}}};\n{text}", "form.c"), write(table, "form.toml"))
        assert np.abs(answer.soft_iron - expected).max() < 1e-12, keys


FIT_C = """
typedef struct { float off[3]; float mat[3][3]; struct { unsigned good : 1; } flags; float *more; } cal_t;
float beta, history[5];
static float hidden(float x) { return x * beta; }
int fit(const float (*samples)[3], int count, cal_t *out)
{ out->off[0] = hidden(samples[0][0]) + 0.0f * history[count % 5]; return count < 0; }
int both(cal_t *one, const cal_t *other) { return one != other; }
double ratio(const void *p, double x) { return p ? x : 0.0; }
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("out.off", "out.offset", r"bad.toml:4: hard_iron: .*cal_t has no member offset; nearest: off$"),
        ("out.off", "out", r"hard_iron: .*out.more is float \*, a pointer"),
        ("out.off", "result", r"hard_iron: .*no variable result; there are: .*out.*samples"),
        ("out.off", "out.off[1]", r"hard_iron is 3 numbers, and these are 1 \(out.off\[1\] is float\)"),
        ("out.off", "history[6]", r"has the elements 0 to 4"),
        ("out.off", "samples[400000]", r"outside samples, which has 1048576 bytes"),
        ('"samples"', '"history"', r"magnetometer: .*history\[5\]: float\[5\] has the elements 0 to 4"),
        ('"samples"', '"out.more[i]"', r"magnetometer"),
        ("fit(samples", "fitt(samples", r"bad.toml: no function fitt in .*fit.c; correct its call"),
        ("fit(samples, count, &out)", "fit(samples, count)", r"fit\(const float\[\] \*, int, cal_t \*\) takes 3"),
        ("fit(samples, count, &out)", "both(&out, &out)", r"a variable is passed twice by address"),
        ("&out", "0.5", r"0.5 is no cal_t \*; pass a variable: &name"),
        ("count", "&count", r"count is int, not a pointer; write count alone"),
        ("count", "n", r"no argument is count, the number of samples"),
        ("fit(samples", "fit samples", r"bad.toml:2: calibrate: .* is not a call; write one as in C"),
        ('unit = "uT" }\nhard', 'unit = "deg" }\nhard', r":3: magnetometer.unit: 'deg' does not fit; write one of uT"),
        (', unit = "uT" }\nhard', "}\nhard", r"bad.toml:3: magnetometer.unit: is missing; write one of uT, nT"),
        ("hard_iron", "hardiron", r"bad.toml:4: unknown key 'hardiron'; did you mean 'hard_iron'"),
        ('{ path = "samples"', '{ axes = ["x", "x", "z"], path = "samples"', r"magnetometer.axes: must be x, y and z"),
        ("\nhard_iron", '\nheading = { unit = "deg" }\nhard_iron', r":4: heading: does not belong to a"),
        ("\nhard_iron", '\nsuccess = "maybe"\nhard_iron', r"bad.toml:4: success: input should be 'zero', 'nonzero'"),
        ("\nhard_iron", "\n[[", r"bad.toml:4: not TOML"),
        (
            "\nhard_iron",
            '\nconstants = { "beta" = 1.0, "gamma" = 2.0 }\nhard_iron',
            r"constants.gamma: .*no variable gamma; there are",
        ),
        ('fit(samples, count, &out)"', 'ratio(&p, count)"', r"the size of const void \* is not known; write"),
    ],
)
def test_each_mistake_names_line_key_and_the_next_step(write: Write, old: str, new: str, message: str) -> None:
    good = SIMPLE_TOML.replace('path = "out"', 'path = "out.off"')
    source = write(FIT_C, "fit.c")
    assert answer_of(source, write(good, "good.toml")).hard_iron_ut.shape == (3,)
    assert old in good
    with pytest.raises(ConfigError, match=message):
        answer_of(source, write(good.replace(old, new, 1), "bad.toml"))


def test_a_constant_is_written_before_the_first_call(write: Write) -> None:
    table = SIMPLE_TOML.replace('path = "out"', 'path = "out.off"') + 'constants = { "beta" = 2.0 }\n'
    answer = answer_of(write(FIT_C, "fit.c"), write(table, "beta.toml"))
    assert answer.hard_iron_ut[0] == pytest.approx(2.0 * WORLDS[0].samples_ut[0, 0], rel=1e-6)  # float32


@pytest.mark.parametrize("on_host", [False, True], ids=["core", "host"])
def test_a_function_that_writes_outside_a_variable_or_overflows_a_type_has_no_row(write: Write, on_host: bool) -> None:
    build = library if on_host else str
    text = "void fit(const signed char (*samples)[3], int count, float *out) { out[3] = samples[0][0]; }"
    table = SIMPLE_TOML.replace("&out", "out")
    with pytest.raises(
        ConfigError, match=r"fit writes outside out.* in world rig/3|in world rig/3.*fit writes outside out"
    ):
        answer_of(build(write(text, "fit.c")), write(table, "fit.toml"))
    with pytest.raises(
        ConfigError, match=r"magnetometer: -?\d+ does not fit (const )?signed char; check unit and scale"
    ):
        answer_of(build(write(text, "fit.c")), write(table.replace('"uT"', '"nT"', 1), "fit.toml"))


def test_a_fault_names_the_world_and_the_reading(write: Write) -> None:
    text = FIT_C.replace("return count", "*(volatile int *)0xffffff00 = 1; return count")
    with pytest.raises(BoardFault, match=r"fit.c in world rig/3: "):
        answer_of(write(text, "fit.c"), write(SIMPLE_TOML.replace('path = "out"', 'path = "out.off"'), "fit.toml"))
    text = MAHONY_C.replace(
        "float w =", "if (fabsf(state->q[3]) > 0.1f) *(volatile int *)0xffffff00 = 1;\n    float w ="
    )
    source, table = write(text, "mahony.c"), write(QUATERNION_TOML, "mahony.toml")
    with opened(source, table) as judged:
        assert isinstance(judged, ForeignFilter)
        with pytest.raises(BoardFault, match=r"in the motion rig, reading \d+: "):
            judged.follow(motion())


def test_damaged_files_are_refused(write: Write, tmp_path: Path) -> None:
    elf = Path(linked(write(FIT_C, "fit.c"), "-Wl,-e,fit"))
    table = write(SIMPLE_TOML.replace('path = "out"', 'path = "out.off"'), "fit.toml")
    content, generator = elf.read_bytes(), np.random.default_rng(41)
    for _ in range(60):
        damaged = bytearray(content)
        for place in generator.integers(0x40, len(content), 40):
            damaged[place] = generator.integers(256)
        elf.write_bytes(damaged)
        try:
            answer_of(str(elf), table)
        except (ConfigError, BoardFault):
            continue
    for text in (
        b"\xff\xfe",
        b"a = " + b"[" * 100_000,
        b"a = " + b"9" * 10_000,
        b"calibrate = 3",
        b'magnetometer = "x"',
    ):
        (tmp_path / "bad.toml").write_bytes(text)
        with pytest.raises(ConfigError, match=r"bad.toml"):
            answer_of(str(elf), str(tmp_path / "bad.toml"))


def test_the_command_judges_by_a_table(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write(RANGE_C, "range.c")

    def judge(*words: str) -> int:
        with pytest.raises(SystemExit) as ended:
            main(["judge", *words])
        return int(ended.value.code or 0)

    write(RANGE_TOML, "mine.toml")
    assert judge("range.c", "--signature", "mine.toml", "--alone", "--limit", "bound.median=16") == 0
    assert "range.c" in capsys.readouterr().out
    assert judge("range.c", "--signature", "mine.toml", "--function", "mag_cal") == 4
    assert judge("mine.py:fit", "--signature", "mine.toml") == 4
    assert judge("range.c", "--signature", "mine.toml", "--recording", "trial.npz") == 4
    assert "mine.toml describes a calibrator" in capsys.readouterr().err
