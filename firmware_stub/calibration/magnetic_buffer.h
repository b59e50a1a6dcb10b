/**
 * @file magnetic_buffer.h
 * @brief Points spread over directions: the buffer of the public sensor-fusion libraries, with the constants of release 5.00.
 *
 * NXP (Freescale) Sensor Fusion library, release 5.00, magnetic.c.
 *
 * Each direction of the calibrated field has a cell, which holds the raw counts that fell into it last. While there is room, cells
 * without a point of their own direction also take points whose direction is taken, if no point held is near.
 */
#ifndef HILTEST_MAGNETIC_BUFFER_H
#define HILTEST_MAGNETIC_BUFFER_H

#include "magnetometer_calibrator.h"

/** Rows by x over z, cells of a row by y over z and the sign of x. */
#define MAGNETIC_BUFFER_ROWS 14
#define MAGNETIC_BUFFER_ROW_CELLS (2 * MAGNETIC_BUFFER_ROWS)
#define MAGNETIC_BUFFER_CELLS (MAGNETIC_BUFFER_ROWS * MAGNETIC_BUFFER_ROW_CELLS)

/** Points at which the buffer is full: each new one then frees the oldest. */
#define MAGNETIC_BUFFER_FULL 340

/** Nearer than this [counts, sum over the axes], two points count as one: 5 uT. */
#define MAGNETIC_BUFFER_MESH 50

/** No cell: a direction in the plane z = 0. */
#define MAGNETIC_BUFFER_NO_CELL (-1)

typedef struct {
    int16_t points[MAGNETIC_BUFFER_CELLS][3]; /**< raw [counts] */
    uint32_t stored[MAGNETIC_BUFFER_CELLS];   /**< time of storing, from 1; 0 in an empty cell */
    uint16_t held;                            /**< cells that are not empty */
} magnetic_buffer_t;

/** The cell of a direction, or MAGNETIC_BUFFER_NO_CELL; components at most 1e7, in any unit that leaves them some digits. */
int32_t magnetic_buffer_cell(int32_t x, int32_t y, int32_t z);

/** Store a point, or drop it when its cell is taken and another point is near. Times increase from call to call. */
void magnetic_buffer_store(magnetic_buffer_t *buffer, int32_t cell, const int16_t point[3], uint32_t time);

/** Copy the points of `count` cells from `first` on to `points`, in the order of the cells; returns their number. */
uint16_t magnetic_buffer_gather(const magnetic_buffer_t *buffer, int32_t first, int32_t count, int16_t points[][3]);

/** The range of all points held, at least one [counts]. */
void magnetic_buffer_range(const magnetic_buffer_t *buffer, int16_t minimum[3], int16_t maximum[3]);

#endif
