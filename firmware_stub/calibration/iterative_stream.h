/**
 * @file iterative_stream.h
 * @brief `iterative-stream`: the public sensor-fusion libraries' magnetic calibration as it runs in life, with the constants of 5.00.
 *
 * NXP (Freescale) Sensor Fusion library, release 5.00, magnetic.c, which numbers no equations; the slices are those of release 7.
 * element_fits.h and magnetic_buffer.h are the solvers and the buffer of the same source.
 *
 * Time. Each point is one fusion loop, 25 a second, as the libraries run: intervals and ageing are counted in points. They sort a
 * sample of every loop, of 40 ms; points that a bench collects faster are still one loop each, since what is compared is work a point.
 *
 * Each loop sorts the point into the buffer, its cell by its direction under the calibration so far (raw counts before the first), then
 * runs a solver when one is due: that of 10 elements from 250 points held on, of 7 from 150, of 4 from 100. The first run of each is
 * due as soon as its points are held: a calibration is wanted early, and what is held never becomes less. Later runs are due 750,
 * 250 or 75 loops (30, 10, 3 s) after the last one started.
 *
 * A calibration is taken over when its field is 10 to 90 uT and there is none yet, or its fit error is not larger than that of the
 * present one, or it has more elements and a fit error of at most 4 %. A fit error ages: it grows with a time constant of a day, by the
 * part that passed since it was last compared.
 *
 * Sliced, it works as release 7 does: each loop does one slice of the solver at work. Those are a start, the sums of a row of cells
 * (4 elements) or of a cell, empty or not (7 and 10), setting the matrix up, one rotation, a look at the residue after each sweep,
 * and the calibration. While sums are formed the buffer takes no points.
 *
 * Written from the description of the method, as well as we can: sums of the 34 monomials about the middle of the range instead of the
 * full scatter matrix about one point, elimination instead of the inverse of the 4x4 matrix, the matrix square root in closed form.
 * Unlike there, a quadric that is no ellipsoid is never taken over.
 */
#ifndef HILTEST_ITERATIVE_STREAM_H
#define HILTEST_ITERATIVE_STREAM_H

#include "element_fits.h"
#include "magnetic_buffer.h"
#include "stream_calibrator.h"

/** The next step of a solver. */
typedef enum {
    WORK_NONE = 0,
    WORK_SUMS,
    WORK_SET_UP,
    WORK_ROTATIONS,
    WORK_RESIDUE,
    WORK_CALIBRATION,
} solver_work_t;

/** A solver on its way. */
typedef struct {
    solver_work_t work;
    uint8_t elements;
    uint8_t row, column; /**< next rotation */
    bool has_rotated;    /**< in this sweep */
    uint16_t sweeps;
    int32_t next_cell;
    int32_t anchor[3]; /**< [counts] */
    float negligible;
    moments_t sums;
    jacobi_t matrix;
} solver_t;

typedef struct {
    magnetic_buffer_t buffer;
    trial_t calibration; /**< the present one, its fit error aged */
    uint8_t elements;    /**< of the solver it comes from; 0 before the first */
    uint16_t sweeps;     /**< that its solver made */
    uint8_t highest;     /**< solver that ran with the most elements */
    bool is_sliced;
    uint32_t loops;      /**< points so far */
    uint32_t started;    /**< loop at which a solver last started; the fit error is as old as that */
    uint32_t accepted;
    solver_t solver;
    int16_t gathered[MAGNETIC_BUFFER_FULL][3]; /**< points of some cells, side by side */
} iterative_stream_t;

STREAM_FUNCTIONS(iterative_stream);

#endif
