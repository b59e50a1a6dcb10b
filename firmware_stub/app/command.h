/**
 * @file command.h
 * @brief The type of a command, and the handlers of all commands.
 */
#ifndef HILTEST_COMMAND_H
#define HILTEST_COMMAND_H

#include "protocol/message.h"
#include "protocol/payload.h"

/**
 * Execute a request.
 *
 * @param request its payload, of a length that the command table allows
 * @param[out] reply data of the reply, after the status; dropped unless the status is OK or NO_CYCLE_COUNTER
 */
typedef status_t (*command_handler_t)(payload_reader_t *request, payload_writer_t *reply);

typedef struct {
    uint8_t type;
    command_handler_t handler;
    uint16_t minimum_length; /**< of the request's payload [bytes] */
    uint16_t maximum_length;
} command_t;

/** The command of a type, NULL when there is none. */
const command_t *command_find(uint8_t type);

/** Longest time a request may give a command to wait for samples [us]; more is a BAD_ARGUMENT. */
#define TIMEOUT_MAXIMUM_US 60000000u

/* link_commands.c */
status_t command_sync(payload_reader_t *request, payload_writer_t *reply);
status_t command_identity(payload_reader_t *request, payload_writer_t *reply);
status_t command_link_statistics(payload_reader_t *request, payload_writer_t *reply);
status_t command_reset(payload_reader_t *request, payload_writer_t *reply);

/* sensor_commands.c */
status_t command_sensors(payload_reader_t *request, payload_writer_t *reply);
status_t command_select(payload_reader_t *request, payload_writer_t *reply);
status_t command_read(payload_reader_t *request, payload_writer_t *reply);

/* point_commands.c */
status_t command_collect(payload_reader_t *request, payload_writer_t *reply);
status_t command_upload(payload_reader_t *request, payload_writer_t *reply);
status_t command_points(payload_reader_t *request, payload_writer_t *reply);
status_t command_clear_points(payload_reader_t *request, payload_writer_t *reply);
status_t command_time_range(payload_reader_t *request, payload_writer_t *reply);

/* calibration_commands.c */
status_t command_calibrate(payload_reader_t *request, payload_writer_t *reply);
status_t command_set_calibration(payload_reader_t *request, payload_writer_t *reply);
status_t command_get_calibration(payload_reader_t *request, payload_writer_t *reply);
status_t command_clear_calibration(payload_reader_t *request, payload_writer_t *reply);

/* accelerometer_commands.c */
status_t command_set_accelerometer(payload_reader_t *request, payload_writer_t *reply);
status_t command_get_accelerometer(payload_reader_t *request, payload_writer_t *reply);
status_t command_fit_accelerometer(payload_reader_t *request, payload_writer_t *reply);

/* pose_commands.c */
status_t command_add_pose(payload_reader_t *request, payload_writer_t *reply);
status_t command_poses(payload_reader_t *request, payload_writer_t *reply);
status_t command_clear_poses(payload_reader_t *request, payload_writer_t *reply);
status_t command_upload_poses(payload_reader_t *request, payload_writer_t *reply);

/* stream_commands.c */
status_t command_reset_stream(payload_reader_t *request, payload_writer_t *reply);
status_t command_feed_stream(payload_reader_t *request, payload_writer_t *reply);
status_t command_remove_from_stream(payload_reader_t *request, payload_writer_t *reply);
status_t command_stream_state(payload_reader_t *request, payload_writer_t *reply);

/* average_commands.c */
status_t command_average(payload_reader_t *request, payload_writer_t *reply);

/* gyroscope_commands.c */
status_t command_gyroscope_rest(payload_reader_t *request, payload_writer_t *reply);
status_t command_integrate_gyroscope(payload_reader_t *request, payload_writer_t *reply);
status_t command_log_gyroscope(payload_reader_t *request, payload_writer_t *reply);

/* gyroscope_calibration_commands.c */
status_t command_fit_gyroscope(payload_reader_t *request, payload_writer_t *reply);
status_t command_set_gyroscope(payload_reader_t *request, payload_writer_t *reply);
status_t command_get_gyroscope(payload_reader_t *request, payload_writer_t *reply);

/* dpi_commands.c */
status_t command_fit_dpi(payload_reader_t *request, payload_writer_t *reply);

/* fusion_commands.c */
status_t command_start_fusion(payload_reader_t *request, payload_writer_t *reply);
status_t command_run_fusion(payload_reader_t *request, payload_writer_t *reply);
status_t command_read_fusion(payload_reader_t *request, payload_writer_t *reply);

/* sequence_commands.c */
status_t command_time_sequence(payload_reader_t *request, payload_writer_t *reply);

#endif
