/**
 * @file fusion_run.h
 * @brief The attitude filter on the board's own sensors while it moves, and what it found, kept until a command asks.
 *
 * Three attitudes run side by side: fused, from accelerometer and magnetometer alone, and from the gyroscope alone. The gyroscope
 * turns at its own rate; each new magnetometer sample, with the accelerometer's latest, updates at the moment it was found.
 */
#ifndef HILTEST_FUSION_RUN_H
#define HILTEST_FUSION_RUN_H

#include "protocol/message.h"
#include "timed_fusion.h"

/** 12.8 s of every sample of a magnetometer at 80 Hz. */
#define FUSION_RECORDS_MAXIMUM 1024u

/** Attitudes at one update: quaternions x, y, z, w, body to north-east-down, in parts of 32767; all 0 for none. */
typedef struct {
    uint32_t time_us; /**< since the run began */
    int16_t fused[4];
    int16_t measured[4]; /**< accelerometer and magnetometer alone */
    int16_t turned[4];   /**< gyroscope alone */
} fusion_record_t;

/** The result of a run. */
typedef struct {
    uint64_t began_us;       /**< on the board's clock */
    uint16_t records;        /**< kept */
    uint16_t no_attitude;    /**< updates that only turned: gravity is unusable */
    uint16_t field_left_out; /**< updates that left the heading: the field is disturbed, vertical or none */
    uint16_t bad_steps;      /**< steps left out */
    uint16_t overruns;       /**< samples lost unread */
    update_costs_t costs;    /**< of the fused attitude alone */
} fusion_summary_t;

/** How to run. */
typedef struct {
    uint8_t slot;      /**< of the calibrations */
    uint8_t every;     /**< one in so many updates is kept, from 1 */
    uint16_t readings; /**< for the first attitude */
} fusion_settings_t;

/**
 * Take the mean of samples of the resting board for the attitude that everything begins with; nothing is kept any more.
 *
 * @param[out] attitude quaternion as above, in full
 */
status_t fusion_run_start(const fusion_settings_t *settings, uint64_t deadline_us, float attitude[4]);

/** Run until a point in time, or until as many records are kept as there is room for. NO_CALIBRATION without a start. */
status_t fusion_run(uint64_t until_us, fusion_summary_t *summary);

/** A record by its number, below those kept. */
const fusion_record_t *fusion_record(uint16_t index);
uint16_t fusion_record_count(void);

#endif
