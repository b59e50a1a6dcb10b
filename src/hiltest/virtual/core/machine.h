/* A Cortex-M machine: core, memories, exceptions, cycle count. This file is the whole interface of the library.
 *
 * It has only plain declarations and no directives, so that cffi can read it unchanged; C includes it after <stdbool.h>
 * and <stdint.h>. References are to the ARMv7-M Architecture Reference Manual, DDI 0403E.
 */

struct machine;

/* Exception numbers of the architecture; 16 + n is external interrupt n. */
enum exception_number {
    EXCEPTION_NONE = 0, EXCEPTION_NMI = 2, EXCEPTION_HARD_FAULT = 3, EXCEPTION_MEM_MANAGE = 4, EXCEPTION_BUS_FAULT = 5,
    EXCEPTION_USAGE_FAULT = 6, EXCEPTION_SVCALL = 11, EXCEPTION_PENDSV = 14, EXCEPTION_SYSTICK = 15,
    FIRST_INTERRUPT = 16, EXCEPTIONS = 256, ACTIVE_EXCEPTIONS = 256, EXCEPTION_WORDS = 8,
};

/* Kinds of fault; exceptions.c has the exception of each, and its bits in CFSR and HFSR. */
enum fault_kind {
    FAULT_NONE, FAULT_EXECUTE_NEVER, FAULT_INSTRUCTION_BUS, FAULT_DATA_BUS, FAULT_UNSTACKING, FAULT_STACKING,
    FAULT_UNDEFINED_INSTRUCTION, FAULT_INVALID_STATE, FAULT_INVALID_RETURN, FAULT_NO_COPROCESSOR, FAULT_UNALIGNED,
    FAULT_DIVIDE_BY_ZERO, FAULT_SUPERVISOR_CALL, FAULT_VECTOR_TABLE, FAULT_BREAKPOINT,
};

/* Causes of faults within their kinds. */
enum fault_cause {
    CAUSE_NONE,
    CAUSE_READ_UNMAPPED,   /* data access: `address`, `size` */
    CAUSE_WRITE_UNMAPPED,
    CAUSE_WRITE_FLASH,
    CAUSE_READ_REFUSED,    /* the bus refused the access and knows the reason */
    CAUSE_WRITE_REFUSED,
    CAUSE_FETCH_UNMAPPED,  /* jump to `address` */
    CAUSE_NO_THUMB_BIT,    /* jump to the even address `address` */
    CAUSE_OPCODE,          /* `value`: the halfword, or both with the first in the upper half */
    CAUSE_FPU_DISABLED,
    CAUSE_COPROCESSOR,
    CAUSE_MISALIGNED,      /* `value` in the register `size`, or the address of an exclusive access */
    CAUSE_EXCLUSIVE,
    CAUSE_DIVISOR,         /* register `size` is zero */
    CAUSE_SVC,
    CAUSE_BKPT,
    CAUSE_STACK_FRAME,     /* no RAM for, or with, a frame at `address` */
    CAUSE_VECTOR_READ,     /* no memory at VTOR `address` */
    CAUSE_VECTOR_THUMB,    /* vector `value` of exception `size` has no Thumb bit */
    CAUSE_RETURN_THREAD,   /* EXC_RETURN `value` while no exception is active */
    CAUSE_RETURN_VALUE,    /* EXC_RETURN `value` fits no active exception */
    CAUSE_RETURN_MODE,     /* stacked xPSR `value` is for another mode */
    CAUSE_RETURN_THUMB,    /* stacked xPSR `value` has no Thumb bit */
};

struct machine_fault {
    int32_t kind;      /* enum fault_kind */
    int32_t cause;     /* enum fault_cause */
    uint32_t place;    /* address of the instruction to name: of the jump, if its target has no code */
    uint32_t address;  /* data address: the bit-band alias, if there is one, whose target is `value` */
    uint32_t value;
    uint32_t size;
};

/* Why `machine_run` returned. */
enum stop_reason {
    STOP_DEADLINE,   /* `cycles` has reached `deadline`: an event is due, or a callback has lowered it */
    STOP_RETURNED,   /* the PC is the address `return_address` */
    STOP_FAULT,      /* `fault` is set; `machine_deliver_fault` takes it to its handler */
    STOP_SLEEP,      /* WFI or WFE with nothing pending, or SLEEPONEXIT: the core sleeps (`sleeping` is set) */
    STOP_LOOP,       /* a branch to itself, which only an interrupt ends; never with `may_loop` */
    STOP_UNSTACKED,  /* an exception has returned with `tells_returns` set */
    STOP_BREAKPOINT, /* the PC is at a breakpoint, see `passes_breakpoint` */
    STOP_WATCHPOINT, /* an access met a watchpoint, see `watch_address`; its instruction is complete */
    STOP_STEP,       /* `instruction_limit` instructions were executed, and pending exceptions then entered */
    STOP_HOST,       /* an event that `stops_at` selects has fired */
    STOP_TURNS,      /* so many instructions that a check for Ctrl-C is due: about 10 ms of wall time */
};

/* The architectural state, and the counts. They may be read and changed only while the machine does not run, or in a
 * callback. In a callback the registers are those before the current instruction, except that it may have transferred
 * some of several words.
 */
struct core {
    int64_t cycles;        /* clock cycles since power-on; inside a callback: at the beginning of the instruction */
    int64_t instructions;  /* executed since power-on, including those that IT blocks skip */
    int64_t idle_cycles;   /* cycles of sleep */
    int64_t memory_cycles; /* cycles in which instructions waited for memories */
    int64_t exception_cycles; /* cycles of completed exceptions that interrupted the thread, entry and return included */
    int64_t exception_since;  /* cycle at which the latest of them was entered */
    int64_t masked_since;  /* cycles without sleep at which PRIMASK was set */
    int64_t longest_masked;/* most cycles without sleep for which PRIMASK was set, until it was cleared */
    int64_t passed;        /* instructions in turns of loops that were counted, not executed */
    int64_t device_loads;  /* loads that devices have answered since power-on, without the current one */
    int32_t interrupts;    /* external interrupts that the part has */
    uint32_t priority_mask;/* implemented bits of a priority byte */

    /* State that a reset of the processor restarts. */
    uint32_t r[16];        /* r13 is the stack pointer in use; r15 the address of the next instruction, bit 0 clear;
                              inside a callback that of the current one */
    uint32_t other_stack;  /* the stack pointer not in use: MSP or PSP */
    uint32_t control;      /* CONTROL: nPRIV, SPSEL, FPCA */
    uint32_t primask, faultmask, basepri;
    uint32_t exception;    /* IPSR: number of the active exception, or 0 */
    uint32_t negative;     /* bit 31 is the N flag */
    uint32_t zero;         /* the Z flag is set if this is 0 */
    uint32_t carry, overflow, saturated; /* C, V, Q: 0 or 1 */
    uint32_t ge;           /* the four GE flags */
    uint32_t it_state;     /* ITSTATE */
    uint32_t thumb;        /* EPSR.T */
    uint32_t fpscr;
    uint32_t s[32];        /* bit patterns */

    /* Exceptions. Bit n % 32 of word n / 32 is exception n, EXCEPTION_NONE to 255. */
    uint32_t pending[8], enabled[8], lines[8], is_active[8];
    uint8_t priority[256]; /* priority bytes; those of NMI and HardFault do not count */
    uint16_t active[256];  /* active exceptions, the running one last */
    int32_t active_count;
    uint32_t priority_grouping; /* AIRCR.PRIGROUP */
    uint32_t vector_table; /* VTOR */
    uint32_t floating_control; /* FPCCR, ASPEN and LSPEN */
    uint32_t lazy_frame;   /* FPCAR while floating-point state is due to be saved, or 0 */
    uint32_t floating_default; /* FPDSCR: modes of FPSCR in a new context */
    uint32_t cfsr, hfsr, bfar; /* fault status for handlers */
    uint32_t fault_enabled;/* bit n: the handler of fault exception n is enabled (SHCSR) */
    bool base_thread_enabled; /* CCR.NONBASETHRDENA */
    bool divide_traps;     /* CCR.DIV_0_TRP */
    bool unaligned_traps;  /* CCR.UNALIGN_TRP */
    bool fpu_enabled;      /* CPACR; see machine_set_fpu */
    bool sleeps_on_exit;   /* SCR.SLEEPONEXIT */
    bool sends_on_pend;    /* SCR.SEVONPEND */
    bool event;            /* the event register */
    bool newly_pending;    /* an exception has become pending since the last event */
    bool is_chained;       /* the next exception entry follows a return without a gap */
    bool is_saved;         /* the floating-point state is in the frame that both handlers of a chain share */
    bool sleeping;
    bool waits_for_event;  /* the sleep is WFE, not WFI */
    bool gated;            /* no interrupt ends the sleep */
    bool sleeps_deeply;    /* SCR.SLEEPDEEP: the caller of machine_run handles sleep; otherwise time passes in it */
    struct machine_fault fault;

    uint32_t taken[8];     /* exceptions that were entered since power-on, a bit each as above */

    /* Behaviour of `machine_run`, which is not part of a snapshot. */
    int64_t deadline;      /* `machine_run` returns before the first instruction that begins at or after this cycle;
                              a callback may lower it */
    int64_t instruction_limit; /* see STOP_STEP */
    bool delivers_faults;  /* firmware runs, not a called function: a jump to `return_address` is a fault */
    int32_t stops_at;      /* enum host_event: events of peripherals in C that end machine_run */
    bool leaves_sleep;     /* STOP_SLEEP in every sleep, as with `sleeps_deeply` */
    bool may_loop;         /* a branch to itself passes time up to the deadline */
    bool tells_returns;
    bool executes_all;     /* for tests: execute every turn of a loop, and ask devices even for known answers */
    bool passes_breakpoint; /* the next instruction executes despite a breakpoint; executing it, or an exception
                               entry, clears this */
    uint32_t return_address;
    uint32_t watch_kinds;  /* enum watch_kind: kinds of the first watchpoint that was met since this was set to 0 */
    uint32_t watch_address;/* its first accessed byte */
};

/* Events that a host waits for: none, bytes for it, or any. */
enum host_event { HOST_NONE, HOST_BYTES, HOST_ANY };

/* Accesses that a watchpoint detects. */
enum watch_kind { WATCH_READ = 1, WATCH_WRITE = 2, WATCH_ACCESS = 3 };

/* Accesses outside memories: peripherals and the processor's own registers. The callee sets `refused` if the
 * access is a bus error. */
struct machine_bus {
    void *context;
    uint32_t (*read)(void *context, uint32_t address, uint32_t size, bool *refused);
    void (*write)(void *context, uint32_t address, uint32_t size, uint32_t value, bool *refused);
};

/* A used stack: the address above it (the stack pointer when it was empty), the lowest value of the stack pointer, and
 * the code that ran at its first use. */
struct machine_stack {
    uint32_t top, lowest, first_pc;
};

/* A function whose calls are watched. */
struct machine_function {
    int64_t abandoned;   /* calls that never returned: longjmp, end of a task or exception, reset */
    int64_t open;        /* calls that have not returned yet */
    int64_t came_back;   /* calls that returned after their stack had been given up */
    int64_t lost;        /* calls that were not recorded: too many are open, or have not been read */
    uint32_t looks_at;   /* address of a word that is read at each return, and its size; 0: none */
    uint32_t look_size;
    bool tells;          /* see machine_tell_entries */
};

/* A call that has returned; see Call in hiltest.virtual.processor.call_summary. */
struct machine_call {
    int64_t entered, returned, interrupts, elsewhere;
    int32_t interrupted;
    int32_t function;
    uint32_t ended_in, word;
    uint32_t stack;      /* bytes; UINT32_MAX if it used two stacks */
    bool outermost;
};

/* Called when a call of a function with `tells` begins, at a cycle of machine_unpaused_cycles. */
typedef void (*machine_entered)(void *context, int32_t function, int64_t cycle);

/* Declaration of a device about a byte of its registers. */
enum device_byte {
    DEVICE_KEEPS = 1,  /* a load changes nothing */
    DEVICE_STEADY = 2, /* it changes only at events, at stores to devices, and at loads that may change something */
    DEVICE_TELLS = 4,  /* the bus must be informed of loads that were answered without it */
};

/* Called after loads of an address by the instruction at `place` were answered without the bus. */
typedef void (*machine_repeated)(void *context, uint32_t address, uint32_t place, int64_t repeats);

/* Make a machine without memories; NULL without room. baseline: an ARMv6-M core. */
struct machine *machine_create(bool baseline);
void machine_destroy(struct machine *machine);
struct core *machine_core(struct machine *machine);
void machine_connect(struct machine *machine, struct machine_bus bus);
/* Declare a page of devices: bits of enum device_byte for each of its 4096 bytes; the caller keeps the array. Repeated
 * loads of steady bytes have the same answer, without the bus. False if the address is not a device's. */
bool machine_declare_page(struct machine *machine, uint32_t base, const uint8_t *bytes);
void machine_tell_repeated(struct machine *machine, machine_repeated tell, void *context);
/* For a device during a load: the load has changed something. */
void machine_load_changed(struct machine *machine);

/* Add a memory; base and size are multiples of 4 KiB. Returns its bytes, for reading only, or NULL if it overlaps
 * another one or there is no room. */
const uint8_t *machine_add_memory(struct machine *machine, uint32_t base, uint32_t size, bool writable);
/* Read and write memories as a debugger does, including flash. False if the range is not in one memory. */
bool machine_read(struct machine *machine, uint32_t address, uint32_t size, uint8_t *bytes);
bool machine_write(struct machine *machine, uint32_t address, uint32_t size, const uint8_t *bytes);
/* Return whether a range is writable memory, where a stack may be. */
bool machine_holds_stack(struct machine *machine, uint32_t address, uint32_t size);

/* Set a row of the timing profile [cycles], in table 0 or in another one from machine_set_tables, before anything runs.
 * False if there is no such row. */
bool machine_set_price(struct machine *machine, int32_t table, const char *row, int32_t value);
/* Set a row of the profile's table [memory], after which memories add cycles, before anything runs. False if there is
 * no such row, the value is out of its range, or there is no room. */
bool machine_set_memory_row(struct machine *machine, const char *row, int32_t value);
/* Flash controller: set the switches of half 0 or 1 of the flash, see waits.h; drop its lines, or empty a way of
 * its cache. Without memory rows they do nothing. */
void machine_switch_flash_bank(
    struct machine *machine, uint32_t bank, bool keeps_line, bool reads_ahead_code, bool reads_ahead_data,
    bool caches_code, bool caches_data);
void machine_forget_flash_lines(struct machine *machine);
void machine_forget_flash_way(struct machine *machine, uint32_t way);

/* Clocks in which peripherals in C count. Ticks at a cycle are ticks + (remainder + (cycle - since) * numerator) /
 * denominator; a clock whose numerator is 0 is stopped. The remainder is below the denominator, which is below 2**31,
 * and its product with the numerator is below 2**62. Returns the number of a new clock, or -1. */
int32_t machine_add_clock(struct machine *machine);
void machine_set_clock(
    struct machine *machine, int32_t clock, int64_t since, int64_t ticks, int64_t remainder, int64_t numerator,
    int64_t denominator);
/* Cycle of the next event of a peripheral in C, INT64_MAX without one; and fire due events. */
int64_t machine_next_event(const struct machine *machine);
void machine_fire_events(struct machine *machine);

/* Peripherals in C, by their first address: open or close the clock gate, reset the device, and access its registers as
 * a debugger or DMA does, which check addresses before. */
void machine_set_clocked(struct machine *machine, uint32_t base, bool is_clocked);
void machine_reset_device(struct machine *machine, uint32_t base);
uint32_t machine_read_device(struct machine *machine, uint32_t address, uint32_t size);
void machine_write_device(struct machine *machine, uint32_t address, uint32_t size, uint32_t value);

/* UARTs with FIFOs of `depth` bytes, 8 or 1: `clock` is the module's, `time` counts picoseconds. */
struct machine_uart {
    int32_t depth;
    int32_t status_interrupt, error_interrupt;
    int32_t receive_request, send_request; /* sources of DMA requests, or one for both */
    int32_t clock, time;
};
bool machine_add_uart(struct machine *machine, uint32_t base, struct machine_uart connections);
/* Set the rate at the far end of the wires, and the duration of a byte at that rate. */
void machine_set_line_baud(struct machine *machine, uint32_t base, double baud, int64_t byte_ps);
/* Return the rate that the firmware has set up, 0 if none. */
double machine_uart_baud(struct machine *machine, uint32_t base);
/* Put bytes on the line towards the board, one after the other at line speed. False, with no effect, if more than
 * 16 MiB would be on the line. */
bool machine_uart_write(struct machine *machine, uint32_t base, const uint8_t *bytes, int32_t count);
/* Return the number of bytes on the line towards the board. */
int32_t machine_uart_arriving(struct machine *machine, uint32_t base);
/* Return the number of bytes that the board has sent and the host has not fetched; and fetch up to `count` of them.
 * Returns their number, or -1 if bytes were lost because the host left more than 16 MiB unfetched. */
int32_t machine_uart_waiting(struct machine *machine, uint32_t base);
int32_t machine_uart_read(struct machine *machine, uint32_t base, uint8_t *bytes, int32_t count);
/* Return the cycles from the latest byte from the host to the first byte after it to the host, of the latest answer; and
 * those of them in which the thread executed, neither asleep nor in an exception. */
struct machine_answer {
    int64_t cycles, awake_cycles;
};
struct machine_answer machine_uart_answer(struct machine *machine, uint32_t base);
/* Set the condition of HOST_BYTES: so many bytes that the host has not fetched, or a byte with a value; -1, the initial
 * value, for none. */
void machine_uart_expect(struct machine *machine, uint32_t base, int32_t count, int32_t byte);

/* I2C masters: `clock` is the module's, `time` counts picoseconds. The callback for the parts on the wires returns
 * whether an address or a byte is acknowledged, or the byte that is read. */
enum i2c_operation { I2C_ADDRESS, I2C_WRITE, I2C_READ, I2C_STOP };
enum i2c_wire { I2C_SDA, I2C_SCL };
typedef uint32_t (*machine_i2c_ask)(void *context, int32_t operation, uint32_t value, int64_t time);
struct machine_i2c {
    int32_t interrupt, request; /* numbers of its external interrupt and of its source of DMA requests */
    int32_t clock, time;
    machine_i2c_ask ask;
    void *context;
};
bool machine_add_i2c(struct machine *machine, uint32_t base, struct machine_i2c connections);
/* Pull a wire low from one time to another, which may be INT64_MAX. */
void machine_hold_wire(struct machine *machine, uint32_t base, int32_t wire, int64_t begin, int64_t end);

/* SysTick, which counts a clock. */
bool machine_add_systick(struct machine *machine, int32_t clock);
/* NVIC and SCB: the callback is for AIRCR's request to reset the chip. SysTick, whose registers are between theirs,
 * must be added before. */
struct machine_system_control {
    void (*request_reset)(void *context);
    void *context;
};
bool machine_add_system_control(struct machine *machine, struct machine_system_control connections);

/* DWT, whose counter may be absent (NOCYCCNT). */
bool machine_add_dwt(struct machine *machine);
void machine_set_counter(struct machine *machine, bool is_present);
/* A reading of CYCCNT, and the devices' answers to loads since the previous reading; -1 if they were too many.
 * The snapshot is of the state before the instruction; it is NULL if a loop polls the counter. */
enum { MOST_ANSWERS = 1000 };
struct machine_reading {
    struct snapshot *snapshot;
    uint32_t count;
    int32_t answer_count;
    uint32_t answers[1000];
};
/* Remove the oldest stored reading, with its snapshot; false if there is none. */
bool machine_take_reading(struct machine *machine, struct machine_reading *reading);

/* PIT. */
struct machine_pit {
    int32_t interrupts[4];
    int32_t clock, time;
};
bool machine_add_pit(struct machine *machine, uint32_t base, struct machine_pit connections);
/* Return the time at which a channel was last enabled. */
int64_t machine_timer_enabled_at(struct machine *machine, uint32_t base, int32_t channel);

/* FTM with so many channels. `changed` is called when a channel that is listened to changes its level, `note` at a
 * write that requests an unmodelled function. */
struct machine_ftm {
    int32_t channels, interrupt;
    int32_t bus_clock, fixed_clock;
    void (*changed)(void *context, int32_t channel);
    void (*note)(void *context, uint32_t address, uint32_t size, uint32_t value);
    void *context;
};
bool machine_add_ftm(struct machine *machine, uint32_t base, struct machine_ftm connections);
/* Select the channels to listen to, a bit each. */
void machine_hear_channels(struct machine *machine, uint32_t base, uint32_t channels);
/* Return the level that a channel drives, -1 for none. For a device during a load, the answer holds until the level may
 * change. */
int32_t machine_channel_level(struct machine *machine, uint32_t base, int32_t channel);
/* Set the level of a channel's pin; and report a rising edge at the pin of the external clock. */
void machine_channel_edge(struct machine *machine, uint32_t base, int32_t channel, bool high);
void machine_ftm_clock_edge(struct machine *machine, uint32_t base);

/* LPTMR, with its clocks by PSR.PCS. Only power-on resets it; its first state is the one after writes of zeros. */
struct machine_lptmr {
    int32_t interrupt;
    int32_t clocks[4];
};
bool machine_add_lptmr(struct machine *machine, uint32_t base, struct machine_lptmr connections);
/* Set the level of the pin that CSR.TPS selects by 1 or 2. */
void machine_lptmr_edge(struct machine *machine, uint32_t base, int32_t pin, bool high);
/* PORT: `changed` is called with rising and falling pins, if a watched pin changes its level or its being pulled low;
 * `connected` when multiplexers select other functions or other pins interrupt; and `ask` when a pin with a signal is
 * read. */
struct machine_port {
    int32_t interrupt;
    uint32_t controls[32]; /* PCR of each pin after a reset */
    void (*changed)(void *context, uint32_t rose, uint32_t fell);
    void (*connected)(void *context);
    void (*ask)(void *context);
    void *context;
};
/* Pins of a port, a bit each. The host sets all but the last three members, and then settles the port. */
struct machine_pins {
    uint32_t outside, outside_high; /* driven from outside the chip, and driven high */
    uint32_t carrying;              /* carry a signal of a peripheral */
    uint32_t signals, signals_high; /* of those, driven by the peripheral, and driven high */
    uint32_t silent;                /* of those, with a level that is known only on request */
    uint32_t watched;
    uint32_t levels, driven_low;    /* results: the levels, and the pins that the processor pulls low */
    uint32_t interrupting;          /* control register requests interrupts */
};
/* NULL without room. */
struct machine_pins *machine_add_port(struct machine *machine, uint32_t base, struct machine_port connections);
void machine_settle_pins(struct machine *machine, uint32_t base);
/* GPIO registers of five ports, by the addresses of the ports. */
bool machine_add_gpio(struct machine *machine, uint32_t base, const uint32_t ports[5]);

/* eDMA and DMAMUX, by their first addresses and that of the PIT, which must be added before. The last interrupt is for
 * errors. */
struct machine_dma {
    uint32_t base, multiplexer, timers;
    int32_t interrupts[17];
};
bool machine_add_dma(struct machine *machine, struct machine_dma connections);
/* Set the level of a source of DMA requests. */
void machine_set_request(struct machine *machine, int32_t source, bool level);

/* Run until there is a reason to stop (enum stop_reason). Pending exceptions are taken before an instruction. */
int32_t machine_run(struct machine *machine);
/* Save the floating-point state of an exception that saves it lazily, if any, and count the cycles. */
void machine_save_floats(struct machine *machine);
/* Empty the pipeline, so that instructions before and after do not overlap. */
void machine_flush_pipeline(struct machine *machine);
/* Return to the state after a processor reset; memories, counts and prices stay. */
void machine_reset(struct machine *machine);

/* xPSR, and the two stack pointers. */
uint32_t machine_xpsr(struct machine *machine);
void machine_set_xpsr(struct machine *machine, uint32_t value);
uint32_t machine_stack_pointer(struct machine *machine, bool process);
void machine_set_stack_pointer(struct machine *machine, bool process, uint32_t value);
/* Set CONTROL as MSR does in privileged thread mode. */
void machine_set_control(struct machine *machine, uint32_t value);

/* Exceptions. */
void machine_pend(struct machine *machine, int32_t exception);
void machine_unpend(struct machine *machine, int32_t exception);
void machine_set_line(struct machine *machine, int32_t interrupt, bool level);
void machine_set_enabled(struct machine *machine, int32_t interrupt, bool enabled);
void machine_set_priority(struct machine *machine, int32_t exception, uint32_t value);
/* Return whether any enabled interrupt, or SysTick, would preempt the running code; `ceiling` as below. */
bool machine_can_ever_wake(struct machine *machine, int32_t ceiling);
/* Return whether the core would wake from its sleep now. */
bool machine_wakes(struct machine *machine);
/* Return the priority that PRIMASK, FAULTMASK and BASEPRI raise execution to: 256 if none. */
int32_t machine_ceiling(struct machine *machine, bool without_primask);
/* Return the most urgent pending and enabled exception above a ceiling, or 0. */
int32_t machine_most_urgent(struct machine *machine, int32_t ceiling);
/* Return the exception that preempts the running code, or 0. */
int32_t machine_next_exception(struct machine *machine, int32_t ceiling);
int32_t machine_preemption_priority(struct machine *machine, int32_t exception);
/* Return the priority of the running code, raised by a ceiling. */
int32_t machine_execution_priority(struct machine *machine, int32_t ceiling);
/* Enter the handler of `fault`; return the exception that was entered, or 0 for lockup. */
int32_t machine_deliver_fault(struct machine *machine);

/* Set CPACR's permission to use the FPU. */
void machine_set_fpu(struct machine *machine, bool enabled);

/* Stop before the instruction at an address, unless an IT block skips it. False if there are too many breakpoints. */
bool machine_set_breakpoint(struct machine *machine, uint32_t address, bool set);
/* Stop after instructions that access a range; `kinds`: enum watch_kind. False if there are too many watchpoints. */
bool machine_add_watchpoint(struct machine *machine, uint32_t address, uint32_t size, uint32_t kinds);
void machine_clear_watchpoints(struct machine *machine);
/* Return whether an IT block skips the next instruction. */
bool machine_skips(struct machine *machine);

/* Executions of an instruction, including jumps, and its jumps. An instruction that an IT block skips is not
 * executed; one that faults is. */
struct machine_executions {
    uint64_t executed, jumped;
};
/* Count executions from now on. False without room. */
bool machine_watch_executions(struct machine *machine);
/* Return the counts of a memory so far, for each of its halfwords; NULL if executions are not watched. */
const struct machine_executions *machine_executions(struct machine *machine, uint32_t base);

/* Causes of waits, in the order in which they are checked. */
enum machine_stall {
    STALL_FETCH, STALL_ADDRESS, STALL_DIVISION, STALL_FP_RESULT, STALL_LOAD_USE, STALL_STORE_BUFFER,
    STALL_TAKEN_BRANCH, STALLS = 7,
};
/* Code of the function that begins at `function`: addresses from `begin` to before `end`. */
struct machine_code_range {
    uint32_t begin, end, function;
};
/* A function as reached along one path of calls; `caller` is the number of the path to its caller, or 0. */
struct machine_path {
    uint32_t function, caller;
    uint64_t entries;    /* calls, including tail calls */
    int64_t idle_cycles; /* sleep */
};
/* Executions of an instruction on a path, without waits for memories. There is an entry for each state of the pipeline
 * before it, and for each row, if an IT block skips it or code was rewritten. */
struct machine_cost {
    uint32_t path, address;
    int32_t row;
    uint64_t executions, jumps;
    uint64_t work_cycles, stall_cycles[7];
};
/* Begin a profile; execution must be in a function. `code` is in the order of addresses. False without room. */
bool machine_begin_profile(
    struct machine *machine, uint32_t function, const struct machine_code_range *code, uint32_t count);
/* End the profile. False if it is incomplete for lack of room. The results stay until the next one begins. */
bool machine_end_profile(struct machine *machine);
/* Return a path by its number, from 1 on, and a cost, from 0 on; NULL after the last one. */
const struct machine_path *machine_path(struct machine *machine, uint32_t number);
const struct machine_cost *machine_cost(struct machine *machine, uint32_t number);
/* Return the name of the timing profile's row that priced a cost. */
const char *machine_row_name(int32_t row);

/* Continuation of execution after an instruction, without faults and exceptions. */
enum machine_flow {
    FLOW_ON,      /* at the next instruction */
    FLOW_JUMP,    /* at `target` */
    FLOW_CALL,    /* at `target`, and then at the next instruction */
    FLOW_LITERAL, /* at the address that the word at `target` holds */
    FLOW_TABLE,   /* at one of several places: in a table of addresses (`entry_size` 4), or of halves of distances from
                     the next instruction (1 or 2) */
    FLOW_RETURN,  /* after the call */
    FLOW_POINTER, /* at an address from a register or a memory */
    FLOW_POINTER_CALL,
};

enum { NO_REGISTER = 16 };

/* An instruction for analysis of code. It describes one of the registers that the instruction writes, the stack pointer
 * if that is one of them. */
struct machine_instruction {
    uint32_t address, target;
    int32_t flow;         /* enum machine_flow */
    int32_t number;
    uint16_t writes;      /* bit n: it writes r[n] */
    uint8_t size;         /* bytes */
    uint8_t entry_size;
    uint8_t result, base; /* r[result] becomes r[base] + `number` if `is_sum`; otherwise another value, which
                             depends on r[base] if `base` is a register */
    bool is_sum;
    bool conditional;     /* the jump has a condition of its own */
    bool in_it_block;     /* the block may skip it */
    bool begins_it_block;
};

/* Decode at most `most` instructions of some code. Returns their number, without an incomplete last one.
 * `it_state` is ITSTATE before the first one, 0 outside an IT block, and is updated to that after the last one. */
int32_t machine_decode(
    uint32_t address, const uint8_t *code, uint32_t size, uint8_t *it_state, struct machine_instruction *decoded,
    int32_t most);

/* Return the used stacks in the order of their first use; valid until the machine runs again. */
const struct machine_stack *machine_stacks(struct machine *machine, int32_t *count);

/* Watch the function at an address from now on. Returns its number, which repeated calls do not change, or -1 if
 * there are too many. */
int32_t machine_watch(struct machine *machine, uint32_t address);
/* Return a watched function, whose address is constant. */
struct machine_function *machine_watched(struct machine *machine, int32_t function);
/* Report each call of functions with `tells`, before its first instruction. */
void machine_tell_entries(struct machine *machine, machine_entered entered, void *context);
/* Return the calls that returned since `machine_forget_calls`, in that order; valid until the machine runs again. */
const struct machine_call *machine_calls(struct machine *machine, int64_t *count);
void machine_forget_calls(struct machine *machine);
/* Ignore calls and cycles between these two. */
void machine_pause_calls(struct machine *machine);
void machine_resume_calls(struct machine *machine);
/* Return the cycles since power-on without those of the pauses. */
int64_t machine_unpaused_cycles(struct machine *machine);

/* The state of a machine with its memories at one moment. It shares pages with other snapshots and with machines: all
 * of them must belong to one thread. */
struct snapshot;
/* Take a snapshot; in a callback it has the state before the current instruction. with_devices: include the peripherals
 * in C and their events. NULL without room. */
struct snapshot *machine_snapshot(struct machine *machine, bool with_devices);
void machine_forget_snapshot(struct snapshot *snapshot);
const struct core *machine_snapshot_core(const struct snapshot *snapshot);
/* Read memories of a snapshot. False if the range is not in one memory. */
bool machine_read_snapshot(const struct snapshot *snapshot, uint32_t address, uint32_t size, uint8_t *bytes);
/* Restore a snapshot of this machine or of another one. Prices, breakpoints, watchpoints and the behaviour of
 * `machine_run` stay. Peripherals stay too, unless the snapshot has them; UARTs then have no byte in transit. Calls
 * that have not returned are abandoned. False, with no effect, inside a callback, if the memories differ, or if the
 * snapshot has the peripherals of another machine. */
bool machine_restore(struct machine *machine, const struct snapshot *snapshot);
/* Make a machine with the same kind of core, zeroed memories, and the same prices. NULL without room. */
struct machine *machine_like(const struct machine *machine);

/* Copy the answers of devices to `count` loads from number `first` on (`device_loads` counts them). False if some are
 * no longer stored. */
bool machine_answers(struct machine *machine, int64_t first, int32_t count, uint32_t *answers);

/* Execution from a snapshot to a load from a device that follows `answer_count` others, without that instruction, or to
 * the return to the snapshot's `return_address`. */
struct slice {
    const struct snapshot *begin;
    int64_t cycles, instructions;
    const uint32_t *answers; /* of the devices */
    int32_t answer_count;
};
/* Use `count` price tables, the machine's own as table 0; the others begin as copies of it. Only
 * `machine_count_again` counts by the others. False if they are too many, or without room. */
bool machine_set_tables(struct machine *machine, int32_t count);
/* Execute a slice again, and add its cycles by each table to `totals`. Devices repeat their answers, and nothing
 * interrupts. False, with `totals` unchanged, if table 0 does not give the slice's cycles and instructions, due to an
 * exception or sleep. The machine needs the same memories as the original one. */
bool machine_count_again(struct machine *machine, const struct slice *slice, int64_t *totals);
/* Execute the function at the beginning of which a snapshot was taken until it returns. Devices answer zero, nothing
 * interrupts, and the flash controller keeps its lines. False if the function does not return within so many cycles;
 * otherwise the cycles since the snapshot are those of the call. */
bool machine_call_again(struct machine *machine, const struct snapshot *begin, int64_t most_cycles);
