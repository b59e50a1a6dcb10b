/* DWT: CYCCNT counts core cycles while TRCENA and CYCCNTENA are set (DDI 0403E, C1.8).
 *
 * The host receives the latest readings with the state before each, to count again the code between them.
 */
#include <stdlib.h>

#include "devices.h"

enum { CTRL = 0x0, CYCCNT = 0x4, CTRL_CYCCNTENA = 1, CTRL_NOCYCCNT = 1 << 25, CTRL_COMPARATORS = 4 << 28 };
enum { POLLS = 16, SOON_CYCLES = 40 }; /* more readings in quick succession are polling, and time no code */
enum { READINGS = 400 };               /* four for each of the 80 steps that one command may time, and a reserve */
static const uint32_t DWT_BASE = 0xE0001000;

/* Reading number n is at n % READINGS, until the host removes it. */
struct readings {
    int64_t added, removed;
    struct machine_reading entries[READINGS];
};

struct dwt {
    struct device device;
    struct readings *readings; /* not part of the state */
    bool is_absent, is_traced, is_enabled;
    uint32_t count; /* at the cycle `since` */
    int64_t since;
    int64_t loads;  /* of devices before the latest reading */
    int64_t read_at;
    uint32_t place; /* instruction of the latest reading */
    int32_t polls;  /* number of similar readings before */
};

static bool is_counting(const struct dwt *dwt) { return dwt->is_traced && dwt->is_enabled && !dwt->is_absent; }

/* Count up to now. */
static void advance(const struct machine *machine, struct dwt *dwt)
{
    if (is_counting(dwt))
        dwt->count += (uint32_t)(machine->core.cycles - dwt->since);
    dwt->since = machine->core.cycles;
}

/* Return a new reading without content. */
static struct machine_reading *add_reading(struct readings *readings)
{
    struct machine_reading *reading = &readings->entries[readings->added++ % READINGS];
    if (readings->added - readings->removed > READINGS)
        readings->removed++;
    machine_forget_snapshot(reading->snapshot);
    reading->snapshot = NULL;
    return reading;
}

static void keep_reading(struct machine *machine, struct dwt *dwt)
{
    struct machine_reading *reading = add_reading(dwt->readings);
    const int64_t loads = machine->core.device_loads - dwt->loads;
    reading->count = dwt->count;
    reading->snapshot = machine_snapshot(machine, false);
    reading->answer_count = loads <= MOST_ANSWERS ? (int32_t)loads : -1;
    if (!machine_answers(machine, dwt->loads, reading->answer_count, reading->answers))
        reading->answer_count = -1;
    dwt->loads = machine->core.device_loads;
}

/* Return whether one instruction polls the counter: it has read it repeatedly, each time soon after the last. */
static bool is_polled(const struct core *core, struct dwt *dwt)
{
    const bool is_again = core->r[15] == dwt->place && core->cycles - dwt->read_at <= SOON_CYCLES;
    dwt->polls = is_again ? dwt->polls + 1 : 0;
    dwt->place = core->r[15];
    dwt->read_at = core->cycles;
    return dwt->polls >= POLLS;
}

static uint32_t read_register(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    struct dwt *dwt = (struct dwt *)device;
    if (offset == CTRL)
        return part_of_word(CTRL_COMPARATORS | dwt->is_enabled | (dwt->is_absent ? CTRL_NOCYCCNT : 0), 0, size);
    if (offset != CYCCNT)
        return 0;
    advance(machine, dwt);
    if (!is_polled(&machine->core, dwt))
        keep_reading(machine, dwt);
    else if (dwt->polls == POLLS)
        add_reading(dwt->readings); /* marks a gap, because the code between polled readings is not kept */
    return part_of_word(dwt->count, 0, size);
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct dwt *dwt = (struct dwt *)device;
    (void)size;
    advance(machine, dwt);
    if (offset == CTRL)
        dwt->is_enabled = value & CTRL_CYCCNTENA;
    else if (offset == CYCCNT)
        dwt->count = value;
}

void enable_trace(struct machine *machine, bool is_enabled)
{
    struct dwt *dwt = (struct dwt *)device_of(machine, DWT_BASE);
    if (!dwt)
        return;
    advance(machine, dwt);
    dwt->is_traced = is_enabled;
}

static void reset(struct machine *machine, struct device *device)
{
    struct dwt *dwt = (struct dwt *)device;
    (void)machine;
    dwt->is_traced = dwt->is_enabled = false;
    dwt->count = 0;
}

static void destroy(struct device *device)
{
    struct readings *readings = ((struct dwt *)device)->readings;
    for (int32_t i = 0; i < READINGS; i++)
        machine_forget_snapshot(readings->entries[i].snapshot);
    free(readings);
}

bool machine_add_dwt(struct machine *machine)
{
    const struct dwt dwt = {
        .device = {
            .base = DWT_BASE, .bytes = PAGE_BYTES, .read = read_register, .write = write_register, .reset = reset,
            .destroy = destroy},
        .readings = calloc(1, sizeof *dwt.readings)};
    if (dwt.readings && add_device(machine, &dwt.device, sizeof dwt))
        return true;
    free(dwt.readings);
    return false;
}

void machine_set_counter(struct machine *machine, bool is_present)
{
    struct dwt *dwt = (struct dwt *)device_of(machine, DWT_BASE);
    if (dwt)
        dwt->is_absent = !is_present;
}

bool machine_take_reading(struct machine *machine, struct machine_reading *reading)
{
    const struct dwt *dwt = (const struct dwt *)device_of(machine, DWT_BASE);
    if (!dwt || dwt->readings->removed == dwt->readings->added)
        return false;
    struct machine_reading *oldest = &dwt->readings->entries[dwt->readings->removed++ % READINGS];
    *reading = *oldest;
    oldest->snapshot = NULL;
    return true;
}
