/* A Cortex-M machine: core, memories, exceptions and cycle count. This file is the complete interface of the library.
 *
 * It has only declarations and no directives, so that cffi can read it unchanged; C includes it after <stdbool.h> and
 * <stdint.h>. References are to the ARMv7-M Architecture Reference Manual, DDI 0403E.
 *
 * Functions that allocate memory return NULL or false if the host is out of memory. Sets have one bit per member.
 */

struct machine;

/* Exception numbers of the architecture; exception 16 + n is external interrupt n. */
enum exception_number {
    EXCEPTION_NONE = 0, EXCEPTION_NMI = 2, EXCEPTION_HARD_FAULT = 3, EXCEPTION_MEM_MANAGE = 4, EXCEPTION_BUS_FAULT = 5,
    EXCEPTION_USAGE_FAULT = 6, EXCEPTION_SVCALL = 11, EXCEPTION_PENDSV = 14, EXCEPTION_SYSTICK = 15,
    FIRST_INTERRUPT = 16, EXCEPTIONS = 256, ACTIVE_EXCEPTIONS = 256, EXCEPTION_WORDS = 8,
};

/* Kinds of fault; exceptions.c has the exception of each kind, and its bits in CFSR and HFSR. */
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
    CAUSE_READ_REFUSED,    /* the bus refused the access, for a reason that the host knows */
    CAUSE_WRITE_REFUSED,
    CAUSE_READ_PROTECTED,  /* the system memory protection refused the access */
    CAUSE_WRITE_PROTECTED,
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
    CAUSE_STACK_FRAME,     /* no RAM at `address`, where a frame is to be written or read */
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
    uint32_t place;    /* address of the responsible instruction: of the jump, if its target has no code */
    uint32_t address;  /* data address; if it is a bit-band alias, `value` is the alias's target */
    uint32_t value;
    uint32_t size;
};

/* Reasons for which `machine_run` returns. */
enum stop_reason {
    STOP_DEADLINE,   /* `cycles` has reached `deadline`, which a callback may have lowered */
    STOP_RETURNED,   /* the PC is `return_address` */
    STOP_FAULT,      /* `fault` is set; `machine_deliver_fault` enters its handler */
    STOP_SLEEP,      /* WFI or WFE without a pending exception or event, or SLEEPONEXIT: `sleeping` is set */
    STOP_LOOP,       /* a branch to itself, which only an interrupt ends; never with `may_loop` */
    STOP_UNSTACKED,  /* an exception has returned while `reports_returns` is set */
    STOP_BREAKPOINT, /* the PC is at a breakpoint, see `passes_breakpoint` */
    STOP_WATCHPOINT, /* an access hit a watchpoint, see `watch_address`; its instruction is complete */
    STOP_STEP,       /* `instruction_limit` instructions were executed, and pending exceptions then entered */
    STOP_HOST,       /* an event that `stops_at` selects has fired */
    STOP_TURNS,      /* after about 10 ms of wall time, to check for Ctrl-C */
};

/* The architectural state, and the counts. They may be accessed only while the machine is not running, or in a
 * callback. In a callback, registers have the values before the current instruction, except that it may have
 * transferred some of several words.
 */
struct core {
    int64_t cycles;        /* clock cycles since power-on; in a callback those at the beginning of the instruction */
    int64_t instructions;  /* instructions since power-on, including those that IT blocks skip */
    int64_t idle_cycles;   /* cycles of sleep */
    int64_t memory_cycles; /* cycles in which instructions waited for memories */
    int64_t address_cycles;/* part of them: the rows unaligned and load_other_block of the profile's costs */
    int64_t exception_cycles; /* cycles of completed exceptions that interrupted the thread, entry and return included */
    int64_t exception_since;  /* cycle at which the latest of them was entered */
    int64_t masked_since;  /* cycles without sleep at which PRIMASK was set */
    int64_t longest_masked;/* most cycles without sleep for which PRIMASK was set, until it was cleared */
    int64_t passed;        /* instructions in turns of loops that were counted without execution */
    int64_t device_loads;  /* loads from devices since power-on, excluding the current one */
    int32_t interrupts;    /* number of external interrupts of the part */
    uint32_t priority_mask;/* implemented bits of a priority byte */

    /* State that a reset of the processor initialises. */
    uint32_t r[16];        /* r13 is the stack pointer in use; r15 is the address of the next instruction, in a callback
                              of the current one, with bit 0 clear */
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

    /* Exceptions. In sets, bit n % 32 of word n / 32 is exception n. */
    uint32_t pending[8], enabled[8], lines[8], is_active[8];
    uint8_t priority[256]; /* priority bytes; those of NMI and HardFault have no effect */
    uint16_t active[256];  /* active exceptions; the last one is running */
    int32_t active_count;
    uint32_t priority_grouping; /* AIRCR.PRIGROUP */
    uint32_t vector_table; /* VTOR */
    uint32_t floating_control; /* FPCCR, ASPEN and LSPEN */
    uint32_t lazy_frame;   /* FPCAR while floating-point state is still to be saved, or 0 */
    uint32_t floating_default; /* FPDSCR: modes of FPSCR in a new context */
    uint32_t cfsr, hfsr, bfar; /* fault status for handlers */
    uint32_t fault_enabled;/* bit n: the handler of exception n, a fault, is enabled (SHCSR) */
    bool base_thread_enabled; /* CCR.NONBASETHRDENA */
    bool divide_traps;     /* CCR.DIV_0_TRP */
    bool unaligned_traps;  /* CCR.UNALIGN_TRP */
    bool fpu_enabled;      /* CPACR; see machine_set_fpu */
    bool sleeps_on_exit;   /* SCR.SLEEPONEXIT */
    bool sends_on_pend;    /* SCR.SEVONPEND */
    bool event;            /* the event register */
    bool newly_pending;    /* an exception has become pending since the last event */
    bool is_chained;       /* the next exception entry follows a return directly (tail-chaining) */
    bool is_saved;         /* the floating-point state is in the frame of tail-chained handlers */
    bool sleeping;
    bool waits_for_event;  /* the core sleeps in WFE, not in WFI */
    bool gated;            /* no interrupt ends the sleep */
    bool sleeps_deeply;    /* SCR.SLEEPDEEP: the caller of machine_run handles sleep; otherwise machine_run does */
    struct machine_fault fault;

    uint32_t taken[8];     /* set of exceptions that were entered since power-on */

    /* Settings of `machine_run`, which are not part of a snapshot. */
    int64_t deadline;      /* `machine_run` returns before the first instruction that begins at or after this cycle;
                              a callback may lower it */
    int64_t instruction_limit; /* see STOP_STEP */
    bool delivers_faults;  /* firmware runs, not a called function, and a jump to `return_address` is a fault */
    int32_t stops_at;      /* enum host_event: events of peripherals in C that end machine_run */
    bool leaves_sleep;     /* STOP_SLEEP in every sleep, as with `sleeps_deeply` */
    bool may_loop;         /* stay in a branch to itself up to the deadline */
    bool reports_returns;  /* see STOP_UNSTACKED */
    bool executes_all;     /* for tests: execute every turn of a loop, and do not cache answers of devices */
    bool passes_breakpoint; /* execute the next instruction despite a breakpoint; its execution, or an exception entry,
                               clears this */
    uint32_t return_address;
    uint32_t watch_kinds;  /* enum watch_kind: kinds of the first watchpoint that was hit since this was set to 0 */
    uint32_t watch_address;/* first byte that was accessed there */
};

/* Events that end machine_run for the host: none, bytes for the host, or any. */
enum host_event { HOST_NONE, HOST_BYTES, HOST_ANY };

/* Accesses that a watchpoint detects. */
enum watch_kind { WATCH_READ = 1, WATCH_WRITE = 2, WATCH_ACCESS = 3 };

/* Callbacks for accesses outside of memories and of peripherals in C. They set `refused` for a bus error. */
struct machine_bus {
    void *context;
    uint32_t (*read)(void *context, uint32_t address, uint32_t size, bool *refused);
    void (*write)(void *context, uint32_t address, uint32_t size, uint32_t value, bool *refused);
};

/* A used stack: its initial and its lowest stack pointer, and the PC at its first use. */
struct machine_stack {
    uint32_t top, lowest, first_pc;
};

/* A function whose calls are watched. */
struct machine_function {
    int64_t abandoned;   /* calls that never returned: longjmp, end of a task or exception, reset */
    int64_t open;        /* calls that have not returned yet */
    int64_t came_back;   /* calls that returned after they had been counted as abandoned */
    int64_t lost;        /* calls that were not recorded: too many are open, or have not been read */
    uint32_t word_address; /* address of a word that is recorded at each return */
    uint32_t word_size;  /* size of the word [bytes]; 0 for none */
    bool reports_entries; /* see machine_report_entries */
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

/* Called when a call of a function with `reports_entries` begins; `cycle` is as in machine_unpaused_cycles. */
typedef void (*machine_entered)(void *context, int32_t function, int64_t cycle);

/* Properties of a byte of a device's registers. */
enum device_byte {
    DEVICE_KEEPS = 1,   /* a load has no side effects */
    DEVICE_STEADY = 2,  /* it changes only at events, at stores to devices, and at loads that have side effects */
    DEVICE_COUNTS = 4,  /* its accesses are counted, also loads that were answered without it */
};

/* Accesses of an instruction to a register that is not modelled. */
struct machine_access {
    uint32_t address, place, size, value; /* value: of the first write */
    bool is_write;
    int64_t count;         /* accesses that were not reported yet */
    int64_t reads;         /* since the latest write to any such register */
    int64_t writes_before; /* number of writes to such registers before the latest access */
};
enum { MACHINE_POLLED_READS = 1000 }; /* more than any driver needs between two writes */
/* Called for the first access of an instruction, when it has polled, and for further counts. */
typedef void (*machine_accessed)(void *context, const struct machine_access *access);

/* Make a machine without memories. baseline: an ARMv6-M core. */
struct machine *machine_create(bool baseline);
void machine_destroy(struct machine *machine);
struct core *machine_core(struct machine *machine);
void machine_connect(struct machine *machine, struct machine_bus bus);
/* Declare the properties of a page of devices, bits of enum device_byte for each of its 4096 bytes; the array must
 * outlive the machine. Repeated loads of steady bytes are answered without the bus. False if the address is not a
 * device's. */
bool machine_declare_page(struct machine *machine, uint32_t base, const uint8_t *bytes);
/* Let another master address an I2C module as slave: an operation of enum i2c_operation; the value of I2C_READ is 1 if the
 * master does not acknowledge. Returns the acknowledgement, or the byte. */
int32_t machine_i2c_slave(struct machine *machine, uint32_t base, int32_t operation, uint32_t value);
/* Add the system memory protection; false if out of memory. */
bool machine_add_sysmpu(struct machine *machine, uint32_t base);
/* stored.c: add a page of registers that only store writes, with their 4096 bytes after reset; false if out of memory. */
bool machine_add_stored(struct machine *machine, uint32_t base, const uint8_t *initial);
void machine_log_accesses(struct machine *machine, machine_accessed report, void *context);
/* Count an access by the current instruction to another register that is not modelled. */
void machine_note_access(struct machine *machine, struct machine_access access);
/* Report all counts, forget them, or stop counting. */
void machine_report_accesses(struct machine *machine);
void machine_forget_accesses(struct machine *machine);
void machine_pause_accesses(struct machine *machine, bool is_paused);
struct machine_access machine_latest_access(struct machine *machine);
/* Send accesses to a further range of addresses to the bus: registers outside of the peripherals' first MiB and of the
 * processor's own. False if there are too many ranges. */
bool machine_add_device_region(struct machine *machine, uint32_t base, uint32_t size);
/* Send stores to flash to the bus from now on, because its controller programs words by stores. */
void machine_pass_flash_stores(struct machine *machine);
/* For a device during a load: the load has a side effect. */
void machine_load_changed(struct machine *machine);

/* Add a memory; base and size are multiples of 4 KiB. Returns its bytes, for reading only; NULL if it overlaps another
 * memory or there are too many. */
const uint8_t *machine_add_memory(struct machine *machine, uint32_t base, uint32_t size, bool writable);
/* Show a memory at a second address, too, where it has the same size and kind. Returns its bytes; NULL if there is no
 * memory at `target`, if it overlaps another one, or if there are too many. */
const uint8_t *machine_add_alias(struct machine *machine, uint32_t base, uint32_t target);
/* Read and write memories as a debugger does, including flash. False if no memory contains the range. */
bool machine_read(struct machine *machine, uint32_t address, uint32_t size, uint8_t *bytes);
bool machine_write(struct machine *machine, uint32_t address, uint32_t size, const uint8_t *bytes);
/* Return whether a range is in writable memory, where a stack may be. */
bool machine_holds_stack(struct machine *machine, uint32_t address, uint32_t size);

/* Set a row of the timing profile [cycles] before the machine runs, in table 0 or in another one of machine_set_tables.
 * False if there is no such row. */
bool machine_set_price(struct machine *machine, int32_t table, const char *row, int32_t value);
/* Set a row of the profile's table [memory] before the machine runs; memories then add cycles. False if there is no
 * such row, or the value is out of its range. */
bool machine_set_memory_row(struct machine *machine, const char *row, int32_t value);
/* Divide the addresses into memory blocks: a load overlaps only a load in the same block (row load_other_block). Without a
 * call the blocks are those of the code buses and of the system bus. False if there are too many blocks. */
bool machine_add_block(struct machine *machine, uint32_t begin);
/* Set the place of the flash, or add a RAM that answers late, for the rows of [memory]. False if out of memory,
 * or if there are too many such RAMs. */
bool machine_set_flash(struct machine *machine, uint32_t begin, uint32_t bytes);
bool machine_add_late_ram(struct machine *machine, uint32_t begin, uint32_t bytes);
/* Flash controller: set the switches of half 0 or 1 of the flash, see waits.h; drop the lines, or empty a way of the
 * cache. Without memory rows these functions do nothing. */
void machine_switch_flash_bank(
    struct machine *machine, uint32_t bank, bool keeps_line, bool reads_ahead_code, bool reads_ahead_data,
    bool caches_code, bool caches_data);
void machine_forget_flash_lines(struct machine *machine);
void machine_forget_flash_way(struct machine *machine, uint32_t way);

/* Clocks of peripherals in C. Ticks at a cycle are ticks + (remainder + (cycle - since) * numerator) / denominator; a
 * clock with a numerator of 0 is stopped. The remainder is below the denominator, the denominator below 2**31, and the
 * product of denominator and numerator below 2**62. `machine_add_clock` returns the number of a new clock, or -1. */
int32_t machine_add_clock(struct machine *machine);
void machine_set_clock(
    struct machine *machine, int32_t clock, int64_t since, int64_t ticks, int64_t remainder, int64_t numerator,
    int64_t denominator);
/* Return the cycle of the next event of a peripheral in C; INT64_MAX without one. */
int64_t machine_next_event(const struct machine *machine);
/* Fire the due events. */
void machine_fire_events(struct machine *machine);

/* Peripherals in C, by their first address: open or close the clock gate, reset the device, and access its registers as
 * a debugger or DMA does, after a check of the address. */
void machine_set_clocked(struct machine *machine, uint32_t base, bool is_clocked);
void machine_reset_device(struct machine *machine, uint32_t base);
uint32_t machine_read_device(struct machine *machine, uint32_t address, uint32_t size);
void machine_write_device(struct machine *machine, uint32_t address, uint32_t size, uint32_t value);

/* UARTs with FIFOs of 8 bytes or 1 byte (`depth`): `clock` is the module's, `time` counts picoseconds. Those of STM32F4
 * parts have no FIFOs, and one interrupt. */
struct machine_uart {
    int32_t depth;
    int32_t status_interrupt, error_interrupt;
    int32_t receive_request, send_request; /* sources of DMA requests, which may be the same */
    int32_t clock, time;
};
bool machine_add_uart(struct machine *machine, uint32_t base, struct machine_uart connections);
bool machine_add_stm32_usart(struct machine *machine, uint32_t base, struct machine_uart connections);
/* Set the host's rate, and the duration of a byte at that rate. */
void machine_set_line_baud(struct machine *machine, uint32_t base, double baud, int64_t byte_ps);
/* Return the rate that the firmware has set up; 0 if it has not. */
double machine_uart_baud(struct machine *machine, uint32_t base);
/* Put bytes on the line towards the board, one after the other at line speed. False, without effect, if more than 16
 * MiB would be on the line. */
bool machine_uart_write(struct machine *machine, uint32_t base, const uint8_t *bytes, int32_t count);
/* Return the number of bytes on the line towards the board. */
int32_t machine_uart_arriving(struct machine *machine, uint32_t base);
/* Return the number of bytes that the board has sent and the host has not fetched. */
int32_t machine_uart_waiting(struct machine *machine, uint32_t base);
/* Fetch up to `count` of them; return their number, or -1 if bytes were lost because the host has not fetched 16
 * MiB. */
int32_t machine_uart_read(struct machine *machine, uint32_t base, uint8_t *bytes, int32_t count);
/* Return the cycles from the latest byte from the host to the first byte after it to the host, of the latest answer; and
 * those of them in which the thread executed, neither asleep nor in an exception. */
struct machine_answer {
    int64_t cycles, awake_cycles;
};
struct machine_answer machine_uart_answer(struct machine *machine, uint32_t base);
/* Set the condition of HOST_BYTES: `count` unfetched bytes, or a byte with the value `byte`; -1, the initial value, for
 * no condition. */
void machine_uart_expect(struct machine *machine, uint32_t base, int32_t count, int32_t byte);

/* I2C masters: `clock` is the module's, `time` counts picoseconds. The callback accesses the parts on the bus; it
 * returns whether an address or a byte was acknowledged, or the byte that was read. */
enum i2c_operation { I2C_ADDRESS, I2C_WRITE, I2C_READ, I2C_STOP };
enum i2c_wire { I2C_SDA, I2C_SCL };
typedef uint32_t (*machine_i2c_ask)(void *context, int32_t operation, uint32_t value, int64_t time);
struct machine_i2c {
    int32_t interrupt, error_interrupt; /* the same one on Kinetis parts */
    int32_t request; /* number of its source of DMA requests, on Kinetis parts */
    int32_t clock, time;
    machine_i2c_ask ask;
    void *context;
};
bool machine_add_i2c(struct machine *machine, uint32_t base, struct machine_i2c connections);
bool machine_add_stm32_i2c(struct machine *machine, uint32_t base, struct machine_i2c connections);
/* Pull a wire low from one time to another, which may be INT64_MAX. */
void machine_hold_wire(struct machine *machine, uint32_t base, int32_t wire, int64_t begin, int64_t end);

/* SysTick, which counts a clock. */
bool machine_add_systick(struct machine *machine, int32_t clock);
/* NVIC and SCB; the callback requests a reset of the chip (AIRCR). SysTick must be added before, because its registers
 * are in the same page. */
struct machine_system_control {
    void (*request_reset)(void *context);
    void *context;
};
bool machine_add_system_control(struct machine *machine, struct machine_system_control connections);

/* DWT, whose counter may be absent (NOCYCCNT). */
bool machine_add_dwt(struct machine *machine);
void machine_set_counter(struct machine *machine, bool is_present);
/* A reading of CYCCNT, and the devices' answers to loads since the previous reading. */
enum { MOST_ANSWERS = 1000 };
struct machine_reading {
    struct snapshot *snapshot; /* state before the instruction; NULL if a loop polls the counter */
    uint32_t count;            /* value of CYCCNT */
    int32_t answer_count;      /* -1 if there were too many answers */
    uint32_t answers[1000];
};
/* Remove the oldest stored reading, and pass its snapshot to the caller; false if there is none. */
bool machine_take_reading(struct machine *machine, struct machine_reading *reading);

/* PIT. */
struct machine_pit {
    int32_t interrupts[4];
    int32_t clock, time;
};
bool machine_add_pit(struct machine *machine, uint32_t base, struct machine_pit connections);
/* Return the time at which a channel was last enabled. */
int64_t machine_timer_enabled_at(struct machine *machine, uint32_t base, int32_t channel);

/* TIMER of the nRF51 on its high-frequency clock. While it is routed, `route` is called with the address of each compare
 * event; `routed` is for the library. */
struct machine_nrf51_timer {
    int32_t interrupt, clock;
    void (*route)(void *context, uint32_t event);
    void (*routed)(void *context, uint32_t event);
    void *context;
};
bool machine_add_nrf51_timer(struct machine *machine, uint32_t base, struct machine_nrf51_timer connections);
void machine_route_nrf51_timer(struct machine *machine, uint32_t base, bool is_routed);

/* A general-purpose timer of STM32F4 parts; the mask has the bits of its counter. */
struct machine_stm32_timer {
    int32_t interrupt, clock;
    uint32_t mask;
};
bool machine_add_stm32_timer(struct machine *machine, uint32_t base, struct machine_stm32_timer connections);

/* FTM. `changed` is called when a reported channel changes its level, `note` at a write that requests an unmodelled
 * function. */
struct machine_ftm {
    int32_t channels, interrupt;
    int32_t bus_clock, fixed_clock;
    void (*changed)(void *context, int32_t channel);
    void (*note)(void *context, uint32_t address, uint32_t size, uint32_t value);
    void *context;
};
bool machine_add_ftm(struct machine *machine, uint32_t base, struct machine_ftm connections);
/* Select the set of reported channels. */
void machine_report_channels(struct machine *machine, uint32_t base, uint32_t channels);
/* Return the level that a channel drives, -1 for none. During a load from a device, the load's answer is then valid
 * until the level may change. */
int32_t machine_channel_level(struct machine *machine, uint32_t base, int32_t channel);
/* Set the level of a channel's pin. */
void machine_channel_edge(struct machine *machine, uint32_t base, int32_t channel, bool high);
/* Report a rising edge at the pin of the external clock. */
void machine_ftm_clock_edge(struct machine *machine, uint32_t base);

/* LPTMR, with its clocks in the order of PSR.PCS. A reset of the chip does not reset it; initially all registers are
 * zero. */
struct machine_lptmr {
    int32_t interrupt;
    int32_t clocks[4];
};
bool machine_add_lptmr(struct machine *machine, uint32_t base, struct machine_lptmr connections);
/* Set the level of the pin that CSR.TPS selects by 1 or 2. */
void machine_lptmr_edge(struct machine *machine, uint32_t base, int32_t pin, bool high);
/* PORT. `changed` is called with rising and falling pins after the level of a watched pin has changed, or the processor
 * has begun or ceased to pull it low; `selected` after the multiplexers have selected other functions, or other pins
 * interrupt; and `declare` before a pin with a signal is read. */
struct machine_port {
    int32_t interrupt;
    uint32_t controls[32]; /* PCR of each pin after a reset */
    void (*changed)(void *context, uint32_t rose, uint32_t fell);
    void (*selected)(void *context);
    void (*declare)(void *context);
    void *context;
};
/* Sets of pins of a port. The host sets all members except the last three, and then calls machine_settle_pins. */
struct machine_pins {
    uint32_t outside, outside_high; /* driven from outside of the chip, and driven high */
    uint32_t with_signals;          /* the multiplexer selects a signal of a peripheral */
    uint32_t signals, signals_high; /* of those, driven by the peripheral, and driven high */
    uint32_t silent;                /* of those, pins whose peripheral does not report edges */
    uint32_t watched;
    uint32_t levels, driven_low;    /* results: the levels, and the pins that the processor pulls low */
    uint32_t interrupting;          /* control register requests interrupts */
};
struct machine_pins *machine_add_port(struct machine *machine, uint32_t base, struct machine_port connections);
void machine_settle_pins(struct machine *machine, uint32_t base);
/* GPIO registers of five ports, which are named by their first addresses. */
bool machine_add_gpio(struct machine *machine, uint32_t base, const uint32_t ports[5]);

/* eDMA and DMAMUX, by the first addresses of their registers and of the PIT, which must be added before. The last
 * interrupt is for errors. */
struct machine_dma {
    uint32_t base, multiplexer, timers;
    int32_t interrupts[17];
};
bool machine_add_dma(struct machine *machine, struct machine_dma connections);
/* DMA controller of STM32F4 parts, whose clock moves items from memory to memory; at most two. A stream with channel c
 * serves source 8 * stream + c of the list; -1 is none. */
struct machine_stm32_dma {
    int32_t interrupts[8];
    int32_t clock;
    int32_t sources[64];
};
bool machine_add_stm32_dma(struct machine *machine, uint32_t base, struct machine_stm32_dma connections);
/* Set the level of a source of DMA requests, 0 to 63. */
void machine_set_request(struct machine *machine, int32_t source, bool level);

/* Run until there is a reason to stop, which is returned (enum stop_reason). Pending exceptions are taken between
 * instructions. */
int32_t machine_run(struct machine *machine);
/* Save the floating-point state if an exception saves it lazily, and count the cycles. */
void machine_save_floats(struct machine *machine);
/* Empty the pipeline, so that instructions before and after the call do not overlap. */
void machine_flush_pipeline(struct machine *machine);
/* Return to the state after a processor reset; memories, counts and prices stay. */
void machine_reset(struct machine *machine);

/* xPSR, and the main or the process stack pointer. */
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
/* Return whether an enabled interrupt, or SysTick, can preempt the running code. `ceiling` here and below: result of
 * machine_ceiling. */
bool machine_can_ever_wake(struct machine *machine, int32_t ceiling);
/* Return whether the core would wake from its sleep now. */
bool machine_wakes(struct machine *machine);
/* Return the execution priority due to PRIMASK, FAULTMASK and BASEPRI; 256 if none is set. */
int32_t machine_ceiling(struct machine *machine, bool without_primask);
/* Return the most urgent pending and enabled exception above a ceiling, or 0. */
int32_t machine_most_urgent(struct machine *machine, int32_t ceiling);
/* Return the exception that preempts the running code, or 0. */
int32_t machine_next_exception(struct machine *machine, int32_t ceiling);
int32_t machine_preemption_priority(struct machine *machine, int32_t exception);
/* Return the priority of the running code, raised by a ceiling. */
int32_t machine_execution_priority(struct machine *machine, int32_t ceiling);
/* Enter the handler of `fault`; return the entered exception, or 0 for lockup. */
int32_t machine_deliver_fault(struct machine *machine);

/* Set CPACR's permission to use the FPU. */
void machine_set_fpu(struct machine *machine, bool enabled);

/* Set or clear a breakpoint: the machine stops before the instruction at an address, unless an IT block skips it. False
 * if there are too many breakpoints. */
bool machine_set_breakpoint(struct machine *machine, uint32_t address, bool set);
/* Add a watchpoint: the machine stops after instructions that access a range; `kinds`: enum watch_kind. False if there
 * are too many watchpoints. */
bool machine_add_watchpoint(struct machine *machine, uint32_t address, uint32_t size, uint32_t kinds);
void machine_clear_watchpoints(struct machine *machine);
/* Return whether an IT block skips the next instruction. */
bool machine_skips(struct machine *machine);

/* Executions of an instruction, and the jumps among them. A faulting instruction counts as executed, one that an IT
 * block skips does not. */
struct machine_executions {
    uint64_t executed, jumped;
};
/* Count executions from now on. */
bool machine_watch_executions(struct machine *machine);
/* Return the counts of a memory, one for each of its halfwords; NULL if executions are not watched. */
const struct machine_executions *machine_executions(struct machine *machine, uint32_t base);

/* Causes of waits, in the order in which they are checked. */
enum machine_stall {
    STALL_FETCH, STALL_ADDRESS, STALL_DIVISION, STALL_FP_RESULT, STALL_LOAD_USE, STALL_STORE_BUFFER,
    STALL_TAKEN_BRANCH, STALLS = 7,
};
/* Range of code, `end` excluded, which belongs to the function that begins at `function`. */
struct machine_code_range {
    uint32_t begin, end, function;
};
/* A function on one path of calls; `caller` is the number of its caller's path, or 0. */
struct machine_path {
    uint32_t function, caller;
    uint64_t entries;    /* calls, including tail calls */
    int64_t idle_cycles; /* sleep */
};
/* Executions of an instruction on a path. An instruction has several entries if it was
 * executed in several states of the pipeline, or was priced by several rows because an IT block skips it or code was
 * rewritten. */
struct machine_cost {
    uint32_t path, address;
    int32_t row;
    uint64_t executions, jumps;
    uint64_t work_cycles, stall_cycles[7];
    int64_t wait_cycles; /* for memories, in addition */
};
/* Begin a profile of a function that is about to be called. `code` is in the order of addresses. */
bool machine_begin_profile(
    struct machine *machine, uint32_t function, const struct machine_code_range *code, uint32_t count);
/* End the profile. Its results are available until the next profile begins. */
bool machine_end_profile(struct machine *machine);
/* Return a path by its number; the first is number 1. NULL after the last one. */
const struct machine_path *machine_path(struct machine *machine, uint32_t number);
/* Return a cost by its number; the first is number 0. NULL after the last one. */
const struct machine_cost *machine_cost(struct machine *machine, uint32_t number);
/* Return the name of the timing profile's row that priced a cost. */
const char *machine_row_name(int32_t row);

/* Successors of an instruction, without faults and exceptions. */
enum machine_flow {
    FLOW_ON,      /* the next instruction */
    FLOW_JUMP,    /* `target` */
    FLOW_CALL,    /* `target`, and then the next instruction */
    FLOW_LITERAL, /* the address in the word at `target` */
    FLOW_TABLE,   /* an entry of a table, which has addresses (`entry_size` 4), or half the distances from the next
                     instruction (`entry_size` 1 or 2) */
    FLOW_RETURN,  /* the instruction after the call */
    FLOW_POINTER, /* an address from a register or a memory */
    FLOW_POINTER_CALL,
};

enum { NO_REGISTER = 16 };

/* An instruction for the analysis of code. `result` is one of the registers that it writes: the stack pointer, if it
 * writes that. */
struct machine_instruction {
    uint32_t address, target;
    int32_t flow;         /* enum machine_flow */
    int32_t number;
    uint16_t writes;      /* bit n: it writes r[n] */
    uint8_t size;         /* bytes */
    uint8_t entry_size;
    uint8_t result, base; /* r[result] becomes r[base] + `number` if `is_sum`, otherwise another value; both may be
                             NO_REGISTER */
    bool is_sum;
    bool conditional;     /* a jump with its own condition */
    bool in_it_block;     /* an IT block may skip it */
    bool begins_it_block;
};

/* Decode at most `most` instructions of some code. Returns their number, excluding an incomplete last one. *it_state is
 * ITSTATE, 0 outside an IT block; it is updated from before the first instruction to after the last one. */
int32_t machine_decode(
    uint32_t address, const uint8_t *code, uint32_t size, uint8_t *it_state, struct machine_instruction *decoded,
    int32_t most);

/* Return the used stacks in the order of their first use; valid until the machine runs again. */
const struct machine_stack *machine_stacks(struct machine *machine, int32_t *count);
/* Forget all stacks; the next move of the stack pointer begins one. */
void machine_forget_stacks(struct machine *machine);

/* Watch the function at an address from now on. Returns its number, also if it is already watched, or -1 if there are
 * too many. */
int32_t machine_watch(struct machine *machine, uint32_t address);
/* Return the record of a watched function, which does not move. */
struct machine_function *machine_watched(struct machine *machine, int32_t function);
/* Set the callback for calls of functions with `reports_entries`, which is called before their first instructions. */
void machine_report_entries(struct machine *machine, machine_entered entered, void *context);
/* Return the calls that have returned since `machine_forget_calls`, in that order; valid until the machine runs
 * again. */
const struct machine_call *machine_calls(struct machine *machine, int64_t *count);
void machine_forget_calls(struct machine *machine);
/* Ignore calls and cycles between these two functions. */
void machine_pause_calls(struct machine *machine);
void machine_resume_calls(struct machine *machine);
/* Return the cycles since power-on without those of the pauses. */
int64_t machine_unpaused_cycles(struct machine *machine);

/* State of a machine with its memories at one moment. Snapshots share pages with each other and with machines, so all
 * of them must belong to one thread. */
struct snapshot;
/* Take a snapshot; in a callback it has the state before the current instruction. with_devices: include the peripherals
 * in C and their events. */
struct snapshot *machine_snapshot(struct machine *machine, bool with_devices);
void machine_forget_snapshot(struct snapshot *snapshot);
const struct core *machine_snapshot_core(const struct snapshot *snapshot);
/* Read memories of a snapshot. False if no memory contains the range. */
bool machine_read_snapshot(const struct snapshot *snapshot, uint32_t address, uint32_t size, uint8_t *bytes);
/* Restore a snapshot of this machine or of another one. Prices, breakpoints, watchpoints and the settings of
 * `machine_run` do not change, nor do peripherals unless the snapshot has them; UARTs then have no byte in transit.
 * Open calls are abandoned. False, without effect, in a callback, if the memories differ, or if the snapshot has the
 * peripherals of another machine. */
bool machine_restore(struct machine *machine, const struct snapshot *snapshot);
/* Make a machine with the same kind of core, the same memories but zeroed, and the same prices. */
struct machine *machine_like(const struct machine *machine);

/* Copy the answers of devices to `count` loads, beginning with load number `first` as counted by `device_loads`. False
 * if some are no longer stored. */
bool machine_answers(struct machine *machine, int64_t first, int32_t count, uint32_t *answers);

/* Execution from a snapshot to the return to the snapshot's `return_address`, or to before the instruction that reads a
 * device for the (`answer_count` + 1)th time. */
struct slice {
    const struct snapshot *begin;
    int64_t cycles, instructions;
    const uint32_t *answers; /* values that devices returned */
    int32_t answer_count;
};
/* Use `count` price tables: the machine's own is table 0, and the others begin as copies of it. Only
 * `machine_count_again` counts by the others. False if there are too many. */
bool machine_set_tables(struct machine *machine, int32_t count);
/* Execute a slice again, and add its cycles by each table to `totals`. Devices repeat their answers, and there are no
 * interrupts. False, with `totals` unchanged, if table 0 does not reproduce the slice's cycles and instructions, due to
 * an exception or sleep. The machine must have the same memories as the original one. */
bool machine_count_again(struct machine *machine, const struct slice *slice, int64_t *totals);
/* Execute the function at whose beginning a snapshot was taken, until it returns. Devices return zero, there are no
 * interrupts, and the flash controller keeps its lines. False if the function does not return within `most_cycles`;
 * otherwise the cycles since the snapshot are those of the call. */
bool machine_call_again(struct machine *machine, const struct snapshot *begin, int64_t most_cycles);
