/* System memory protection of Kinetis parts: regions of memory in which the core may not read or write (K64 reference
 * manual, chapter "Memory Protection Unit"). Fetches, exception frames and DMA are not checked. */
#include "devices.h"

enum { CESR = 0x000, EAR0 = 0x010, RGD0 = 0x400, RGDAAC0 = 0x800, PORTS = 5, REGIONS = 12 };
enum { START, END, RIGHTS, VALID, WORDS };
enum { CESR_VLD = 1, REGION_VLD = 1, GRANULE = 31 };
#define CESR_FIXED 0x00815100u /* revision, five ports, twelve regions */
#define CESR_ERRORS 0xF8000000u
#define DEBUGGER_RIGHTS 0xFC0u /* those of region 0 cannot be changed */
#define ALL_RIGHTS 0x61F7DFu
enum { READ = 4, WRITE = 2, SUPERVISOR_AS_USER = 3 };
enum { FLASH_PORT = 0, CODE_PORT = 2, SYSTEM_PORT = 3 }; /* of flash, SRAM_L and SRAM_U */
#define SRAM_L_BEGIN 0x1C000000u
#define SRAM_U_BEGIN 0x20000000u

struct sysmpu {
    struct device device;
    uint32_t control;
    uint32_t addresses[PORTS], details[PORTS];
    uint32_t regions[REGIONS][WORDS];
};

/* -- rights ------------------------------------------------------------------------------------------------------- */

static bool is_user(const struct core *core) { return core->exception == EXCEPTION_NONE && (core->control & 1); }

/* Rights of the core in a region, as bits READ and WRITE. */
static uint32_t rights_of(uint32_t word, bool user)
{
    static const uint32_t SUPERVISOR[] = {READ | WRITE, READ, READ | WRITE};
    const uint32_t supervisor = word >> 3 & 3;
    return user || supervisor == SUPERVISOR_AS_USER ? word & (READ | WRITE) : SUPERVISOR[supervisor];
}

static bool grants_all(uint32_t word)
{
    return rights_of(word, true) == (READ | WRITE) && rights_of(word, false) == (READ | WRITE);
}

void update_protection(struct machine *machine)
{
    const struct sysmpu *sysmpu = (const struct sysmpu *)machine->sysmpu;
    const bool protects = sysmpu && sysmpu->control & CESR_VLD && !grants_all(sysmpu->regions[0][RIGHTS]);
    if (protects == machine->protects)
        return;
    machine->protects = protects;
    open_all_pages(machine);
}

static int32_t port_of(uint32_t address)
{
    return address < SRAM_L_BEGIN ? FLASH_PORT : address < SRAM_U_BEGIN ? CODE_PORT : SYSTEM_PORT;
}

bool is_permitted(struct machine *machine, uint32_t address, uint32_t size, bool writes)
{
    struct sysmpu *sysmpu = (struct sysmpu *)machine->sysmpu;
    const bool user = is_user(&machine->core);
    uint32_t hits = 0;
    for (uint32_t i = 0; i < REGIONS; i++) {
        const uint32_t *region = sysmpu->regions[i];
        const bool hit = region[VALID] & REGION_VLD && address >= (region[START] & ~(uint32_t)GRANULE)
            && address + size - 1 <= (region[END] | GRANULE);
        if (hit && rights_of(region[RIGHTS], user) & (writes ? WRITE : READ))
            return true;
        hits |= hit ? 1u << (31 - i) : 0;
    }
    const int32_t port = port_of(address);
    sysmpu->control |= 1u << (31 - port);
    sysmpu->addresses[port] = address;
    sysmpu->details[port] = hits | (user ? 1u : 3u) << 1 | writes; /* master 0, a data access */
    return false;
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    (void)machine;
    const struct sysmpu *sysmpu = (struct sysmpu *)device;
    if (offset == CESR)
        return sysmpu->control | CESR_FIXED;
    if (offset >= EAR0 && offset < EAR0 + 8 * PORTS)
        return (offset & 4 ? sysmpu->details : sysmpu->addresses)[(offset - EAR0) / 8];
    if (offset >= RGD0 && offset < RGD0 + 16 * REGIONS)
        return sysmpu->regions[(offset - RGD0) / 16][offset / 4 % WORDS];
    if (offset >= RGDAAC0 && offset < RGDAAC0 + 4 * REGIONS)
        return sysmpu->regions[(offset - RGDAAC0) / 4][RIGHTS];
    return 0;
}

static void write_region(struct sysmpu *sysmpu, uint32_t number, uint32_t word, bool is_alternate, uint32_t value)
{
    uint32_t *region = sysmpu->regions[number];
    if (number == 0 && word != RIGHTS)
        return;
    if (number == 0)
        value = (value & ~DEBUGGER_RIGHTS) | (region[RIGHTS] & DEBUGGER_RIGHTS);
    region[word] = word == START ? value & ~(uint32_t)GRANULE : word == END ? value | GRANULE : value;
    if (word != VALID && number != 0 && !is_alternate)
        region[VALID] &= ~(uint32_t)REGION_VLD;
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct sysmpu *sysmpu = (struct sysmpu *)device;
    if (size != 4)
        return; /* the registers accept words */
    if (offset == CESR)
        sysmpu->control = (sysmpu->control & CESR_ERRORS & ~value) | (value & CESR_VLD);
    else if (offset >= RGD0 && offset < RGD0 + 16 * REGIONS)
        write_region(sysmpu, (offset - RGD0) / 16, offset / 4 % WORDS, false, value);
    else if (offset >= RGDAAC0 && offset < RGDAAC0 + 4 * REGIONS)
        write_region(sysmpu, (offset - RGDAAC0) / 4, RIGHTS, true, value);
    update_protection(machine);
}

static void reset(struct machine *machine, struct device *device)
{
    struct sysmpu *sysmpu = (struct sysmpu *)device;
    machine->sysmpu = device;
    sysmpu->control = CESR_VLD;
    for (int32_t i = 0; i < PORTS; i++)
        sysmpu->addresses[i] = sysmpu->details[i] = 0;
    for (int32_t i = 0; i < REGIONS; i++) {
        sysmpu->regions[i][START] = sysmpu->regions[i][RIGHTS] = sysmpu->regions[i][VALID] = 0;
        sysmpu->regions[i][END] = GRANULE;
    }
    sysmpu->regions[0][END] = UINT32_MAX;
    sysmpu->regions[0][RIGHTS] = ALL_RIGHTS;
    sysmpu->regions[0][VALID] = REGION_VLD;
    update_protection(machine);
}

bool machine_add_sysmpu(struct machine *machine, uint32_t base)
{
    const struct sysmpu sysmpu = {.device = {
        .base = base, .bytes = PAGE_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
        .reset = reset}};
    return add_device(machine, &sysmpu.device, sizeof sysmpu) != NULL;
}
