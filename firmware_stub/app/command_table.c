#include "command.h"

/** One line a command: type, handler, shortest and longest payload of the request. */
static const command_t commands[] = {
    {0x01, command_sync, 4, 4},
    {0x02, command_identity, 0, 0},
    {0x03, command_sensors, 0, 0},
    {0x04, command_select, 1, 1},
    {0x05, command_read, 6, 6},
    {0x06, command_collect, 6, 6},
    {0x07, command_upload, 3, 3 + 160 * 6},
    {0x08, command_points, 3, 3},
    {0x09, command_clear_points, 0, 0},
    {0x0A, command_calibrate, 5, 5 + 255},
    {0x0B, command_set_calibration, 49, 49},
    {0x0C, command_get_calibration, 1, 1},
    {0x0D, command_clear_calibration, 1, 1},
    {0x0E, command_average, 8, 8},
    {0x0F, command_gyroscope_rest, 11, 11},
    {0x10, command_link_statistics, 0, 0},
    {0x11, command_reset, 0, 0},
    {0x12, command_reset_stream, 2, 2 + 255},
    {0x13, command_feed_stream, 4, 4 + 255},
    {0x14, command_remove_from_stream, 4, 4 + 255},
    {0x15, command_stream_state, 1, 1 + 255},
    {0x16, command_set_accelerometer, 49, 49},
    {0x17, command_get_accelerometer, 1, 1},
    {0x18, command_add_pose, 7, 7},
    {0x19, command_poses, 2, 2},
    {0x1A, command_clear_poses, 0, 0},
    {0x1B, command_upload_poses, 2, 2 + 20 * 51},
    {0x1C, command_fit_accelerometer, 2, 2 + 255},
    {0x1D, command_fit_dpi, 9, 9},
    {0x1E, command_integrate_gyroscope, 6, 6},
    {0x1F, command_fit_gyroscope, 1, 1 + 8 * 58},
    {0x20, command_set_gyroscope, 48, 48},
    {0x21, command_get_gyroscope, 0, 0},
    {0x22, command_start_fusion, 8, 8},
    {0x23, command_run_fusion, 4, 4},
    {0x24, command_read_fusion, 3, 3},
    {0x25, command_log_gyroscope, 6, 6},
    {0x26, command_time_sequence, 2, 2},
    {0x27, command_time_range, 2, 2},
};

const command_t *command_find(uint8_t type)
{
    for (size_t i = 0; i < sizeof commands / sizeof commands[0]; i++) {
        if (commands[i].type == type) {
            return &commands[i];
        }
    }
    return NULL;
}
