/**
 * @file sequence_commands.c
 * @brief TIME_SEQUENCE: what instructions cost on this core.
 */
#include "boards/instruction_sequences.h"
#include "command.h"
#include "timed_run.h"

status_t command_time_sequence(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t sequence = read_u8(request);
    const uint8_t place = read_u8(request);
    if (sequence >= sequence_count() || place >= SEQUENCE_PLACES) {
        return STATUS_BAD_ARGUMENT;
    }
    const uint32_t second_half_cycles = sequence_cycles_from_middle(sequence, (sequence_place_t)place);
    write_u32(reply, sequence_cycles(sequence, (sequence_place_t)place) - second_half_cycles);
    write_u32(reply, second_half_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}
