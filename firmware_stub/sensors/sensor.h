/**
 * @file sensor.h
 * @brief One kind of measurement of one part: how to find it, set it up and read it.
 *
 * The three parts share a layout that makes one reader enough: a status register with "x, y and z are new" in bit 3 and "x, y or z
 * was overwritten unread" in bit 7, followed by six bytes, big-endian x, y, z.
 */
#ifndef HILTEST_SENSOR_H
#define HILTEST_SENSOR_H

#include <stdbool.h>
#include <stdint.h>

#include "axes.h"

typedef enum { SENSOR_MAGNETOMETER = 0, SENSOR_ACCELEROMETER = 1, SENSOR_GYROSCOPE = 2 } sensor_kind_t;
#define SENSOR_KIND_COUNT 3u

typedef enum {
    SENSOR_OK = 0,
    SENSOR_NOT_READY, /**< no new sample yet */
    SENSOR_ABSENT,    /**< nothing answers at its address, or another part does */
    SENSOR_TIMED_OUT, /**< no new sample before the deadline */
    SENSOR_BUS_ERROR, /**< the bus failed while the sensor was spoken to */
} sensor_status_t;

typedef struct sensor sensor_t;

/** A register and the value it gets. */
typedef struct {
    uint8_t address;
    uint8_t value;
} register_setting_t;

/** How a part keeps samples until a burst reads many of them; all zero where its FIFO is not used. */
typedef struct {
    const register_setting_t *settings; /**< instead of the driver's */
    uint8_t setting_count;
    uint8_t status_register; /**< bit 7: full, samples were lost; bits 5 to 0: how many it holds */
    uint8_t data_register;   /**< a burst from here gives sample after sample, the oldest first */
    uint32_t start_up_us;    /**< from the last setting to the first sample, at least */
} fifo_layout_t;

/** The constants of a driver's part. */
typedef struct {
    sensor_kind_t kind;
    uint8_t who_am_i_register;
    uint8_t who_am_i;
    uint8_t status_register; /**< data follow it */
    uint8_t temperature_register;
    uint8_t mode_register;              /**< reads 0 in standby */
    uint32_t period_us;                 /**< between samples, as the settings make it */
    const register_setting_t *settings; /**< the first sends the part to standby, the last makes it measure */
    uint8_t setting_count;
    fifo_layout_t fifo;
    axis_map_t to_body;
} sensor_driver_t;

/** A part on this board. */
struct sensor {
    const char *name;
    const sensor_driver_t *driver;
    uint8_t bus;
    uint8_t address; /**< 7 bit */
};

/** A measurement in the body frame. */
typedef struct {
    uint64_t time_us; /**< when it was found to be ready [us]; the sampler's to fill in */
    int16_t body[3];  /**< [counts] */
    bool overrun;     /**< at least one sample before it was never read */
} sample_t;

/** Ask who is there. `seen` gets the answer, 0 when there is none. SENSOR_OK, SENSOR_ABSENT or SENSOR_BUS_ERROR. */
sensor_status_t sensor_probe(const sensor_t *sensor, uint8_t *seen);

/** Parts may ignore everything for this long after power-on [us]: the slowest is the FXAS21002C, which boots for 50 ms. */
#define SENSOR_BOOT_US 60000u

/**
 * Write the settings.
 *
 * All parts ignore them silently unless they are in standby, and a part that measures goes there only when the sample under way
 * is complete; so the mode is asked until it is standby. SENSOR_TIMED_OUT when it is not after 200 ms.
 */
sensor_status_t sensor_configure(const sensor_t *sensor);

/** Write the settings under which samples are kept in the part's FIFO, likewise. */
sensor_status_t sensor_configure_fifo(const sensor_t *sensor);

/** Ask how many samples the FIFO holds, and whether any was lost since it was last read. */
sensor_status_t sensor_fifo_look(const sensor_t *sensor, uint8_t *held, bool *lost);

/** Most samples of one sensor_fifo_read(): 3.5 ms on the bus, within what a transaction may take. */
#define SENSOR_FIFO_BURST 24u

/** Take the `count` oldest samples out of the FIFO, 1 to SENSOR_FIFO_BURST and no more than it holds. */
sensor_status_t sensor_fifo_read(const sensor_t *sensor, int16_t body[][3], uint8_t count);

/**
 * Read the sample that waits, if one does.
 *
 * The status is read alone first. A burst over status and data at every look would lose the sample that becomes ready between the
 * status byte and the data: reading the data clears the flag. Once ready, status and data come in one burst.
 */
sensor_status_t sensor_read_if_ready(const sensor_t *sensor, sample_t *sample);

/** Read and drop what waits, so that the next sample is one that was completed after this call. */
sensor_status_t sensor_discard(const sensor_t *sensor);

/** Read what the data registers hold now, new or not: at most one period old while the sensor measures. */
sensor_status_t sensor_read_latest(const sensor_t *sensor, int16_t body[3]);

/** Temperature of the die as the part gives it: signed, about 1 degC a step, its offset not trimmed. */
sensor_status_t sensor_die_temperature(const sensor_t *sensor, int8_t *degc);

#endif
