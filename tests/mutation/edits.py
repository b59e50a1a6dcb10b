"""The edits: one place of one source file each, and what must be named first of what it breaks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from ..end_to_end.firmware_edits import Edit


class Mistake(StrEnum):
    """Kinds of mistakes that engineers make."""

    SIGN = "sign"
    SWAP = "swap"
    TRANSPOSE = "transpose"
    STALE = "stale state"
    OFF_BY_ONE = "off by one"
    CONSTANT = "wrong constant"
    LOST = "lost sample"
    ROUNDING = "wrong rounding"
    UNCHECKED = "skipped check"
    PRECISION = "precision"
    COST = "cost"
    CLOCK = "clock"


@dataclass(frozen=True)
class Mutation:
    """One mistake.

    Attributes
    ----------
    name : str
        What is wrong then.
    mistake : Mistake
    edit : Edit
    first : str
        Regular expression that the first red test, its failure or its cause must match.
    """

    name: str
    mistake: Mistake
    edit: Edit
    first: str


def _of(mistake: Mistake, file: str, *edits: tuple[str, str, str, str]) -> Iterator[Mutation]:
    for name, old, new, first in edits:
        yield Mutation(name, mistake, Edit(file, old, new), first)


_MAG = "void axes_mag3110(const int16_t sensor[3], int16_t body[3])\n{\n    body[0] = negated(sensor[1]);\n    body[1] = negated(sensor[0]);\n    body[2] = limited(sensor[2]);"
_ACC = "    body[0] = limited(sensor[1]);\n    body[1] = limited(sensor[0]);"
_FXOS = "void axes_fxos8700_magnetometer(const int16_t sensor[3], int16_t body[3])\n{\n    body[0] = negated(sensor[1]);\n    body[1] = negated(sensor[0]);\n    body[2] = negated(sensor[2]);"
_GYRO = "void axes_gyroscope(const int16_t sensor[3], int16_t body[3])\n{\n    body[0] = negated(sensor[1]);\n    body[1] = negated(sensor[0]);\n    body[2] = negated(sensor[2]);"
_FACES = "accelerometer|six|face"
_SLOT = "calibration"


def mutations() -> tuple[Mutation, ...]:
    """Return all of them, in a fixed order."""
    return (
        *_of(Mistake.SIGN, "sensors/axes.c",
             ("magnetometer z negated", _MAG, _MAG.replace("limited(sensor[2])", "negated(sensor[2])"), "magnetometer"),
             ("magnetometer x negated", _MAG, _MAG.replace("body[0] = negated", "body[0] = limited"), "magnetometer"),
             ("accelerometer x negated", _ACC, _ACC.replace("body[0] = limited", "body[0] = negated"), _FACES),
             ("accelerometer y negated", _ACC, _ACC.replace("body[1] = limited", "body[1] = negated"), _FACES),
             ("second magnetometer z positive", _FXOS, _FXOS.replace("body[2] = negated", "body[2] = limited"), "second|axes|magnetometer"),
             ("gyroscope z positive", _GYRO, _GYRO.replace("body[2] = negated", "body[2] = limited"), "gyroscope"),
             ("gyroscope x positive", _GYRO, _GYRO.replace("body[0] = negated", "body[0] = limited"), "gyroscope")),
        *_of(Mistake.SWAP, "sensors/axes.c",
             ("magnetometer x and y exchanged", _MAG, _MAG.replace("sensor[1]", "sensor[9]").replace("sensor[0]", "sensor[1]").replace("sensor[9]", "sensor[0]"), "magnetometer"),
             ("accelerometer x and y exchanged", _ACC, _ACC.replace("sensor[1]", "sensor[9]").replace("sensor[0]", "sensor[1]").replace("sensor[9]", "sensor[0]"), _FACES),
             ("gyroscope x and y exchanged", _GYRO, _GYRO.replace("sensor[1]", "sensor[9]").replace("sensor[0]", "sensor[1]").replace("sensor[9]", "sensor[0]"), "gyroscope"),
             ("second magnetometer x and y exchanged", _FXOS, _FXOS.replace("sensor[1]", "sensor[9]").replace("sensor[0]", "sensor[1]").replace("sensor[9]", "sensor[0]"), "second|axes|magnetometer")),
        *_of(Mistake.SIGN, "orientation/tilt_heading.c",
             ("sine of pitch negated", "const float sin_pitch = -g[0] * per_down;", "const float sin_pitch = g[0] * per_down;", "heading"),
             ("side of the field negated", "const float side = b[2] * sin_roll - b[1] * cos_roll;", "const float side = b[1] * cos_roll - b[2] * sin_roll;", "heading"),
             ("answered pitch negated", "*pitch_deg = atan2f(-g[0], across)", "*pitch_deg = atan2f(g[0], across)", "tilt|pitch|attitude|accelerometer"),
             ("answered roll negated", "? atan2f(g[1], g[2]) * DEGREES", "? atan2f(-g[1], g[2]) * DEGREES", "tilt|roll|attitude|accelerometer")),
        *_of(Mistake.UNCHECKED, "orientation/tilt_heading.c",
             ("headings from -180", "const float turned = heading < 0.0f ? heading + 360.0f : heading;", "const float turned = heading;", "heading"),
             ("no tilt compensation", "const float sin_roll = across > 0.0f ? g[1] * per_across : 0.0f;", "const float sin_roll = 0.0f;", "heading")),
        *_of(Mistake.CONSTANT, "orientation/tilt_heading.c",
             ("degrees a radian 57.3", "#define DEGREES_PER_RADIAN 57.29577951f", "#define DEGREES_PER_RADIAN 57.3f", "heading")),
        *_of(Mistake.ROUNDING, "orientation/tilt_heading.c",
             ("heading to a tenth of a degree", "*heading_deg = turned < 360.0f ? turned : 0.0f;", "*heading_deg = floorf(turned * 10.0f) * 0.1f;", "heading")),
        *_of(Mistake.SIGN, "app/calibration_slots.c",
             ("hard iron added", "field[1] - calibration->hard_iron[1]", "field[1] + calibration->hard_iron[1]", "heading")),
        *_of(Mistake.TRANSPOSE, "app/calibration_slots.c",
             ("soft iron transposed and applied by columns", "        unit[axis] = row[0] * x + row[1] * y + row[2] * z;\n        row += 3;", "        unit[axis] = row[0] * x + row[3] * y + row[6] * z;\n        row += 1;", "heading")),
        *_of(Mistake.STALE, "app/calibration_slots.c",
             ("a filled slot keeps its calibration", "    slots[slot].calibration = *calibration;\n", "    if (!slots[slot].filled) {\n        slots[slot].calibration = *calibration;\n    }\n", _SLOT),
             ("a cleared slot stays filled", "    slots[slot].filled = false;\n", "", _SLOT),
             ("a cleared slot keeps its accelerometer", "    slots[slot].has_accelerometer = false;\n", "", _SLOT)),
        *_of(Mistake.STALE, "app/server.c",
             ("any payload of a sequence number is a repetition", " && request->crc == last.crc;", ";", "link|request")),
        *_of(Mistake.UNCHECKED, "app/server.c",
             ("a repeated request is carried out again", "    if (is_repeated(&request)) {", "    if (is_repeated(&request) && request.crc == 0u) {", "link|request")),
        *_of(Mistake.UNCHECKED, "protocol/message.c",
             ("damaged frames are taken", "return message->crc == crc32(body, length - CRC_BYTES);", "return message->crc != 0u || crc32(body, length) != 0u;", "link|damaged")),
        *_of(Mistake.SWAP, "sensors/sensor.c",
             ("low byte first", "(bytes[0] << 8 | bytes[1])", "(bytes[1] << 8 | bytes[0])", "accelerometer|face|gyroscope|temperature|spread|noise")),
        *_of(Mistake.LOST, "sensors/sensor.c",
             ("overruns are not seen", "sample->overrun = (bytes[0] & STATUS_XYZ_OVERWRITTEN) != 0u;", "sample->overrun = false;", "overrun|overwritten|lost"),
             ("an overflow of the FIFO is not seen", "*lost = (flags & FIFO_OVERFLOWED) != 0u;", "*lost = false;", "overrun|lost|FIFO")),
        *_of(Mistake.STALE, "sensors/sensor.c",
             ("temperature is always 25", "*degc = (int8_t)byte;", "*degc = byte == 0xFFu ? 0 : 25;", "temperature")),
        *_of(Mistake.OFF_BY_ONE, "sensors/sensor.c",
             ("the last setting is not written", "for (uint8_t i = 1; i < count && status == SENSOR_OK; i++) {", "for (uint8_t i = 1; i + 1u < count && status == SENSOR_OK; i++) {", "sensor|TIMED_OUT|timed out|SENSOR")),
        *_of(Mistake.CONSTANT, "sensors/mag3110.c",
             ("RAW is not set", "#define CTRL_REG2_AUTO_RESET_RAW 0xA0u", "#define CTRL_REG2_AUTO_RESET_RAW 0x80u", "offset|hard iron|magnetometer"),
             ("temperature of the MAG3110 from the register before", ".temperature_register = 0x0F,", ".temperature_register = 0x0E,", "temperature"),
             ("the MAG3110 at 40 Hz", "#define CTRL_REG1_80_HZ_ACTIVE 0x01u", "#define CTRL_REG1_80_HZ_ACTIVE 0x21u", "rate|magnetometer|tumble|READ|COLLECT|board.virtual_seconds")),
        *_of(Mistake.CONSTANT, "sensors/fxos8700.c",
             ("accelerometer at 2 g", "#define XYZ_DATA_CFG_4_G 0x01u", "#define XYZ_DATA_CFG_4_G 0x00u", _FACES),
             ("accelerometer at 8 g", "#define XYZ_DATA_CFG_4_G 0x01u", "#define XYZ_DATA_CFG_4_G 0x02u", _FACES),
             ("accelerometer offsets are left", "    {OFF_X + 1u, 0x00},\n", "", "accelerometer|offset")),
        *_of(Mistake.CONSTANT, "sensors/fxas21002.c",
             ("gyroscope at 1000 dps", "#define CTRL_REG0_2000_DPS 0x00u", "#define CTRL_REG0_2000_DPS 0x01u", "gyroscope"),
             ("temperature of the gyroscope from the register before", ".temperature_register = 0x12,", ".temperature_register = 0x11,", "temperature")),
        *_of(Mistake.LOST, "app/sample_series.c",
             ("every sample counted twice", "            statistics_add(&next->statistics, sample.body);\n", "            statistics_add(&next->statistics, sample.body);\n            statistics_add(&next->statistics, sample.body);\n", "AVERAGE|spread|noise|readings|heading|accelerometer")),
        *_of(Mistake.LOST, "app/gyroscope_commands.c",
             ("the first sample of each burst for all", "take(context, done + i, body[i]);", "take(context, done + i, body[0]);", "gyroscope|burst|sample"),
             ("every 50th sample of a turn is left out", "        turn->sum[axis] += value; /*", "        turn->sum[axis] += index % 50u == 49u ? 0 : value; /*", "gyroscope")),
        *_of(Mistake.SIGN, "app/gyroscope_commands.c",
             ("bias added in the rest", "corrected[axis] -= gyroscope_calibration()->bias[axis];", "corrected[axis] += gyroscope_calibration()->bias[axis];", "gyroscope")),
        *_of(Mistake.UNCHECKED, "app/gyroscope_commands.c",
             ("a bias is stored though the board moved", "    return !sampler->lost && (!is_to_be_tested || rest->stillness.verdict.kind == STILLNESS_STILL);", "    return !sampler->lost || is_to_be_tested;", "gyroscope|bias|moved"),
             ("a bias is never stored", "        gyroscope_bias_set(mean);\n", "        (void)mean;\n", "gyroscope|bias")),
        *_of(Mistake.OFF_BY_ONE, "app/gyroscope_commands.c",
             ("one sample more at the beginning of a turn", "index < EDGE_SAMPLES ? value", "index <= EDGE_SAMPLES ? value", "gyroscope|turn")),
        *_of(Mistake.SIGN, "app/gyroscope_calibration.c",
             ("bias added to rates", "counts[2] - calibration->bias[2]", "counts[2] + calibration->bias[2]", "gyroscope|fusion"),
             ("bias not taken off rates", "counts[0] - calibration->bias[0]", "counts[0]", "gyroscope|fusion")),
        *_of(Mistake.STALE, "app/gyroscope_calibration.c",
             ("biases add up", "held.bias[axis] = bias[axis];", "held.bias[axis] += bias[axis];", "gyroscope|fusion")),
        *_of(Mistake.CONSTANT, "app/gyroscope_calibration.c",
             ("0.061 dps a count", "#define DPS_PER_COUNT 0.0625f", "#define DPS_PER_COUNT 0.061035f", "gyroscope|fusion|scale")),
        *_of(Mistake.OFF_BY_ONE, "app/vector_statistics.c",
             ("a mean over one more", "(float)statistics->sum[axis] / (float)statistics->count;", "(float)statistics->sum[axis] / (float)(statistics->count + 1u);", "accelerometer|magnetometer|gyroscope"),
             ("spread with n instead of n - 1", "((float)count * (float)(count - 1))", "((float)count * (float)count)", "spread|noise")),
        *_of(Mistake.ROUNDING, "app/vector_statistics.c",
             ("means to whole counts", "(float)statistics->sum[axis] / (float)statistics->count;", "(float)(statistics->sum[axis] / (int32_t)statistics->count);", "heading|magnetometer|accelerometer|gyroscope|means")),
        *_of(Mistake.PRECISION, "app/vector_statistics.h",
             ("squares summed in float32", "int64_t sum_of_squares[3];", "float sum_of_squares[3];", "spread|noise|BUILD")),
        *_of(Mistake.SWAP, "app/average_commands.c",
             ("mean of the accelerometer for the magnetometer", "statistics_mean(&series[SENSOR_MAGNETOMETER].statistics, field);", "statistics_mean(&series[SENSOR_ACCELEROMETER].statistics, field);", "heading|DEGENERATE|contradict"),),
        *_of(Mistake.STALE, "app/average_commands.c",
             ("the accelerometer's calibration is not used", "accelerometer_apply(slot_accelerometer(slot), acceleration, gravity_g);", "accelerometer_apply(&accelerometer_nominal, acceleration, gravity_g);", "accelerometer|heading|contradict")),
        *_of(Mistake.UNCHECKED, "calibration/accelerometer_six_position.c",
             ("a misplaced face is taken", "faces.misplaced |= is_on_face(pose->accelerometer, pose->face) ? 0u : bit;", "faces.misplaced |= is_on_face(pose->accelerometer, pose->face) ? 0u : 0u * bit;", "face"),
             ("a repeated face is taken", "faces.repeated |= faces.given & bit;", "faces.repeated |= faces.given & bit & 0u;", "face"),
             ("a missing face is taken", "const uint8_t missing = (uint8_t)(all & ~faces.given);", "const uint8_t missing = (uint8_t)(all & ~faces.given & 0u);", "face"),
             ("a face that moves is taken", "faces.moved |= accelerometer_moved(pose) ? bit : 0u;", "faces.moved |= accelerometer_moved(pose) ? 0u * bit : 0u;", "face")),
        *_of(Mistake.CONSTANT, "calibration/accelerometer_six_position.c",
             ("faces askew by 60 degrees are taken", "#define FACE_COSINE 0.94f", "#define FACE_COSINE 0.5f", "face")),
        *_of(Mistake.TRANSPOSE, "calibration/accelerometer_six_position.c",
             ("gain transposed", "fit->calibration.gain[3u * row + column] = x", "fit->calibration.gain[3u * column + row] = x", _FACES)),
        *_of(Mistake.SIGN, "calibration/accelerometer_six_position.c",
             ("a cofactor negated", "const float xz = m[1] * m[5] - m[2] * m[4];", "const float xz = m[2] * m[4] - m[1] * m[5];", _FACES)),
        *_of(Mistake.CONSTANT, "calibration/accelerometer_calibration.h",
             ("1/8000 g a count", "#define ACCELEROMETER_G_PER_COUNT (1.0f / 8192.0f)", "#define ACCELEROMETER_G_PER_COUNT (1.0f / 8000.0f)", "accelerometer|nominal|contradict")),
        *_of(Mistake.OFF_BY_ONE, "calibration/moments.c",
             ("a sum over one point less", "    sums->one = (float)points->count;", "    sums->one = (float)(points->count - 1u);", "direct|fit")),
        *_of(Mistake.SWAP, "calibration/moments.c",
             ("two sums exchanged", "    sums->xxyz = s_xxyz;", "    sums->xxyz = s_xyyz;", "direct|fit|heading")),
        *_of(Mistake.PRECISION, "calibration/moments.c",
             ("anchor at the origin", "    anchor[0] = (points->minimum[0] + points->maximum[0]) / 2;\n    anchor[1] = (points->minimum[1] + points->maximum[1]) / 2;\n    anchor[2] = (points->minimum[2] + points->maximum[2]) / 2;", "    (void)points;\n    anchor[0] = anchor[1] = anchor[2] = 0;", "heading|cycles|float32|samples|fit")),
        *_of(Mistake.COST, "calibration/direct.c",
             ("the sums are made twice", "    moments_sum(points, anchor, &sums);\n", "    moments_sum(points, anchor, &sums);\n    moments_sum(points, anchor, &sums);\n", "cycles.direct")),
        *_of(Mistake.COST, "calibration/iterative.c",
             ("the matrix is diagonalised twice", "    fit->iterations = jacobi_diagonalise(&work, TEN_ELEMENTS, limit);\n", "    fit->iterations = jacobi_diagonalise(&work, TEN_ELEMENTS, limit);\n    ten_elements_assemble(&sums, &work);\n    ten_elements_scale(unit, &work);\n    fit->iterations = jacobi_diagonalise(&work, TEN_ELEMENTS, limit);\n", "cycles.iterative")),
        *_of(Mistake.CONSTANT, "calibration/jacobi.c",
             ("swept until 1e-4", "#define NEGLIGIBLE 1.4901161e-8f", "#define NEGLIGIBLE 1.0e-4f", "iterative")),
        *_of(Mistake.SIGN, "calibration/quadric.c",
             ("centre mirrored", "const float scale = -0.5f / determinant;", "const float scale = 0.5f / determinant;", "fit|direct|heading"),
             ("constant added to the level", " - quadric->constant;", " + quadric->constant;", "fit|direct|heading")),
        *_of(Mistake.SWAP, "calibration/square_root.c",
             ("two off-diagonals exchanged", "    root[2] = root[6] = first * a->xz - scale * xz;\n    root[5] = root[7] = first * a->yz - scale * yz;", "    root[5] = root[7] = first * a->xz - scale * xz;\n    root[2] = root[6] = first * a->yz - scale * yz;", "fit|heading|direct|float32")),
        *_of(Mistake.CONSTANT, "calibration/square_root.c",
             ("Newton stops at 0.2", "#define NEWTON_LAST_STEP 2.0e-4f", "#define NEWTON_LAST_STEP 0.2f", "float32|heading|cycles")),
        *_of(Mistake.CONSTANT, "calibration/corrected.c",
             ("one Newton step", "#define NEWTON_STEPS 2", "#define NEWTON_STEPS 1", "corrected"),
             ("never corrected", "#define FEWEST_POINTS 50", "#define FEWEST_POINTS 500", "corrected")),
        *_of(Mistake.SIGN, "calibration/adjusted_moments.c",
             ("noise added to a square", "a->yy = s->yy - one;", "a->yy = s->yy + one;", "corrected")),
        *_of(Mistake.CONSTANT, "calibration/adjusted_moments.c",
             ("fourth moments by 3 instead of 6", "v6 = 6.0f * variance;", "v6 = 3.0f * variance;", "corrected")),
        *_of(Mistake.UNCHECKED, "calibration/normal_equations.h",
             ("points on a plane are fitted", "#define COVERAGE_SINGULAR 1.0e6f", "#define COVERAGE_SINGULAR 1.0e30f", "distribution|plane|refused|samples")),
        *_of(Mistake.UNCHECKED, "calibration/direct.c",
             ("too few points are fitted", "points->count < FIT_ELLIPSOID_UNKNOWNS", "points->count < 1u", "distribution|few|refused|samples")),
        *_of(Mistake.SIGN, "calibration/dpi.c",
             ("offset added to the anchor", "sums->anchor[r] - sums->unit", "sums->anchor[r] + sums->unit", "dpi"),
             ("a cofactor negated", "adjugate[1] = a[2] * c[1] - a[1] * c[2];", "adjugate[1] = a[1] * c[2] - a[2] * c[1];", "dpi")),
        *_of(Mistake.SWAP, "calibration/dpi_sums.c",
             ("two sums exchanged", "block->xz += x * u[2];", "block->xz += y * u[2];", "dpi")),
        *_of(Mistake.OFF_BY_ONE, "calibration/dpi_sums.c",
             ("the first pair is left out", "for (uint32_t index = 0; index < pairs->count; index++) {", "for (uint32_t index = 1; index < pairs->count; index++) {", "dpi")),
        *_of(Mistake.OFF_BY_ONE, "app/pair_collector.c",
             ("a point is stored twice", "            store_pair(&collector);\n", "            store_pair(&collector);\n            if (stored == 7u) {\n                store_pair(&collector);\n            }\n", "tumble|points|COLLECT|repeat")),
        *_of(Mistake.STALE, "app/pair_collector.c",
             ("the acceleration before the point", "const int64_t part = gone < span ? step * gone / span : step;", "const int64_t part = gone < span ? 0 : step;", "dpi|pairs")),
        *_of(Mistake.UNCHECKED, "calibration/direct_stream.c",
             ("a point taken back is added", "step(stream, point, -1)", "step(stream, point, 1)", "stream")),
        *_of(Mistake.ROUNDING, "calibration/exact_moments.c",
             ("the mean is not divided", "mean[axis] = (int32_t)sums->first[axis] / count;", "mean[axis] = (int32_t)sums->first[axis] / (count + 1);", "stream")),
        *_of(Mistake.CONSTANT, "calibration/magnetic_buffer.c",
             ("a limit between rows", "-48, -22, 0, 22, 48,", "-48, -22, 0, 22, 28,", "stream")),
        *_of(Mistake.COST, "app/timed_run.c",
             ("500 cycles less are reported", "    cost.cycles = total - cost.overhead_cycles; /*", "    cost.cycles = total - cost.overhead_cycles - 500u; /*", "contradict"),
             ("a step's cost without its call", "    const uint32_t total = count_step_cycles(step, state, point, status);\n    cost.cycles = total - cost.overhead_cycles;", "    const uint32_t total = count_step_cycles(step, state, point, status);\n    cost.cycles = (total - cost.overhead_cycles) / 2u;", "stream|contradict")),
        *_of(Mistake.CLOCK, "boards/frdm_k64f/clock.c",
             ("the PLL at 100 MHz", "#define C6_PLL_TIMES_36 0x4Cu", "#define C6_PLL_TIMES_36 0x46u", "no answer|connection|synchronis"),
             ("the core at half its clock", "#define CLKDIV1_120_60_40_24 0x01240000u", "#define CLKDIV1_120_60_40_24 0x11240000u", "no answer|connection|clock|time|span")),
        *_of(Mistake.CLOCK, "boards/frdm_k64f/time_base.c",
             ("microseconds of 61 clocks", "PIT_LDVAL(0u) = BUS_CLOCKS_PER_US - 1u;", "PIT_LDVAL(0u) = BUS_CLOCKS_PER_US;", "time|clock|gyroscope|scale|rate")),
        *_of(Mistake.CLOCK, "boards/frdm_k64f/board.c",
             ("a clock of 100 MHz is answered", ".core_clock_hz = CORE_CLOCK_HZ,", ".core_clock_hz = 100000000u,", "clock")),
        *_of(Mistake.SWAP, "orientation/fusion.c",
             ("west for east", "    cross3(gravity_g, field, east);", "    cross3(field, gravity_g, east);", "fusion")),
        *_of(Mistake.SIGN, "orientation/fusion.c",
             ("turned the other way", "const float half_dt_s = 0.5f * dt_s;", "const float half_dt_s = -0.5f * dt_s;", "fusion")),
    )
