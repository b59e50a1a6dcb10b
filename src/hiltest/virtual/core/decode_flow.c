/* Analysis of instructions without executing them: continuation of execution, and changes of the stack pointer. */

#include "decode.h"
#include "machine.h"

static bool writes_back(const struct instruction *i) { return i->mode & MODE_WRITES_BACK; }

/* BX LR, MOV PC, LR, and loads of the PC from the top of the stack. */
static bool returns(const struct instruction *i)
{
    switch (i->operation) {
    case OP_BX: case OP_MOV_PC: return i->m == LR;
    case OP_LDM: return i->n == SP && i->mode == MODE_WRITES_BACK;
    case OP_LDR_I: return i->n == SP && i->immediate == 0;
    case OP_LDR_W: return i->n == SP && i->mode & MODE_POST;
    default: return false;
    }
}

static enum machine_flow flow(const struct instruction *i)
{
    enum { WORD_SHIFT = 2 };
    switch (i->operation) {
    case OP_B: case OP_CBZ: case OP_CBNZ: return FLOW_JUMP;
    case OP_BL: return FLOW_CALL;
    case OP_BLX: return FLOW_POINTER_CALL;
    case OP_TBB: case OP_TBH: return FLOW_TABLE;
    default:
        if (i->transfer == TRANSFER_NONE) return FLOW_ON;
        if (i->operation == OP_LDR_L) return FLOW_LITERAL;
        if (i->operation == OP_LDR_R && i->amount == WORD_SHIFT) return FLOW_TABLE;
        return returns(i) ? FLOW_RETURN : FLOW_POINTER;
    }
}

static uint8_t entry_size(const struct instruction *i)
{
    return i->operation == OP_TBB ? 1 : i->operation == OP_TBH ? 2 : 4;
}

/* Return the number that write-back adds to a base. */
static int32_t written_back(const struct instruction *i)
{
    int32_t bytes = 4 * i->words;
    switch (i->operation) {
    case OP_VLDM: case OP_VSTM: bytes = (int32_t)i->immediate; /* fall through */
    case OP_LDM: case OP_STM: return i->mode & MODE_BEFORE ? -bytes : bytes;
    default: return (int32_t)i->immediate;
    }
}

static void set_sum(struct machine_instruction *described, uint8_t result, uint8_t base, int32_t number)
{
    described->result = result;
    described->base = base;
    described->number = number;
    described->is_sum = true;
}

static void describe_sum(const struct instruction *i, struct machine_instruction *described)
{
    described->result = described->base = NO_REGISTER;
    switch (i->operation) {
    case OP_MOV_R: case OP_MOV_RS: set_sum(described, i->d, i->m, 0); break;
    case OP_ADD_I: case OP_ADD_IS: set_sum(described, i->d, i->n, (int32_t)i->immediate); break;
    case OP_SUB_I: case OP_SUB_IS: set_sum(described, i->d, i->n, -(int32_t)i->immediate); break;
    default:
        if (i->sets_stack) described->result = SP;
        else if (writes_back(i)) set_sum(described, i->n, i->n, written_back(i));
        else if (i->core_writes & 1u << SP) described->result = described->base = SP;
    }
    if (i->in_it_block) described->is_sum = false;
}

static struct machine_instruction describe(uint32_t address, const struct instruction *i)
{
    struct machine_instruction described = {
        .address = address, .flow = flow(i), .size = i->size, .writes = i->core_writes,
        .conditional = i->conditional && !i->in_it_block, .in_it_block = i->in_it_block,
        .begins_it_block = i->operation == OP_IT};
    switch (described.flow) {
    case FLOW_JUMP: case FLOW_CALL: case FLOW_LITERAL: described.target = i->immediate; break;
    case FLOW_TABLE: described.entry_size = entry_size(i); break;
    default: break;
    }
    describe_sum(i, &described);
    return described;
}

static uint16_t halfword(const uint8_t *bytes) { return (uint16_t)(bytes[0] | bytes[1] << 8); }

int32_t machine_decode(
    uint32_t address, const uint8_t *code, uint32_t size, uint8_t *it_state, struct machine_instruction *decoded,
    int32_t most)
{
    int32_t count = 0;
    for (uint32_t place = 0; count < most && size - place >= 2;) {
        uint16_t first = halfword(code + place);
        uint8_t bytes = instruction_size(first);
        if (size - place < bytes) break;
        uint16_t second = bytes == 4 ? halfword(code + place + 2) : 0;
        struct instruction instruction;
        decode_instruction(address + place, first, second, *it_state, false, &instruction);
        decoded[count++] = describe(address + place, &instruction);
        *it_state = instruction.operation == OP_IT ? (uint8_t)instruction.immediate : advance_it_state(*it_state);
        place += bytes;
    }
    return count;
}
