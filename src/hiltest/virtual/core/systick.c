/* SysTick, the 24-bit system timer (DDI 0403E, B3.3). It counts the core clock for every value of CLKSOURCE. */
#include "devices.h"

enum { CSR = 0x0, RVR = 0x4, CVR = 0x8, REGISTER_BYTES = 0x10 };
enum { CSR_ENABLE = 1, CSR_TICKINT = 2, CSR_CLKSOURCE = 4, CSR_COUNTFLAG = 1 << 16, COUNT_MASK = 0xFFFFFF };
static const uint32_t SYSTICK_BASE = 0xE000E010, CALIB_VALUE = 0xC0000000; /* NOREF, SKEW */

struct systick {
    struct device device;
    struct event expiry; /* planned while the timer counts */
    int32_t clock;
    uint32_t control, reload;
    uint32_t held;       /* count while the timer is stopped */
    int64_t expires_at;  /* tick after the one at which the count is zero */
    bool flag;
};

static uint32_t count_of(const struct machine *machine, const struct systick *timer)
{
    if (!timer->expiry.is_planned)
        return timer->held;
    int64_t count = timer->expires_at - ticks_now(machine, timer->clock) - 1;
    return count > 0 ? (uint32_t)count & COUNT_MASK : 0;
}

static void expire_at(struct machine *machine, struct systick *timer, int64_t tick)
{
    timer->expires_at = tick;
    plan_event_at_tick(machine, &timer->expiry, timer->clock, tick);
}

/* Count from a value, or from the reload value if that is zero; if both are zero the count stays zero. */
static void start(struct machine *machine, struct systick *timer, uint32_t count)
{
    cancel_event(machine, &timer->expiry);
    if (count || timer->reload)
        expire_at(machine, timer, ticks_now(machine, timer->clock) + (count ? count : timer->reload) + 1);
}

static void expire(struct machine *machine, struct event *event)
{
    struct systick *timer = OWNER(event, struct systick, expiry);
    timer->flag = true;
    timer->held = 0;
    if (timer->control & CSR_TICKINT)
        machine_pend(machine, EXCEPTION_SYSTICK);
    if (timer->reload)
        expire_at(machine, timer, timer->expires_at + timer->reload + 1);
}

static void reset(struct machine *machine, struct device *device)
{
    struct systick *timer = (struct systick *)device;
    cancel_event(machine, &timer->expiry);
    timer->control = CSR_CLKSOURCE;
    timer->reload = timer->held = 0;
    timer->flag = false;
}

static void write_control(struct machine *machine, struct systick *timer, uint32_t value)
{
    bool was_enabled = timer->control & CSR_ENABLE;
    timer->held = count_of(machine, timer);
    timer->control = (value & (CSR_ENABLE | CSR_TICKINT)) | CSR_CLKSOURCE;
    if (!(value & CSR_ENABLE))
        cancel_event(machine, &timer->expiry);
    else if (!was_enabled)
        start(machine, timer, timer->held);
}

/* Return a word register; a read of CSR clears COUNTFLAG. */
static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    struct systick *timer = (struct systick *)device;
    uint32_t control = timer->flag ? timer->control | CSR_COUNTFLAG : timer->control;
    switch (offset) {
    case CSR:
        if (timer->flag)
            machine_load_changed(machine);
        timer->flag = false;
        return control;
    case RVR: return timer->reload;
    case CVR: return count_of(machine, timer);
    default: return CALIB_VALUE;
    }
}

/* Any write to CVR clears the count. */
static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct systick *timer = (struct systick *)device;
    (void)size;
    if (offset == CSR) {
        write_control(machine, timer, value);
    } else if (offset == RVR) {
        timer->reload = value & COUNT_MASK;
        if (timer->control & CSR_ENABLE && !timer->expiry.is_planned)
            start(machine, timer, 0); /* the count is zero */
    } else if (offset == CVR) {
        timer->flag = false;
        timer->held = 0;
        if (timer->control & CSR_ENABLE)
            start(machine, timer, 0);
    }
}

bool machine_add_systick(struct machine *machine, int32_t clock)
{
    const struct systick timer = {
        .device = {
            .base = SYSTICK_BASE, .bytes = REGISTER_BYTES, .read = read_by_words, .read_word = read_word,
            .write = write_register, .reset = reset},
        .expiry.fire = expire, .clock = clock};
    return add_device(machine, &timer.device, sizeof timer);
}
