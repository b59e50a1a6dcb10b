/**
 * @file dpi_sums.h
 * @brief The 72 sums that the normal equations of `dpi` are made of.
 *
 * A row is the Kronecker product of gravity and (1, x, y, z), so the matrix is 6 blocks of 10 sums each, and nothing is summed twice.
 */
#ifndef HILTEST_DPI_SUMS_H
#define HILTEST_DPI_SUMS_H

#include "dpi.h"

/** A symmetric 4x4 matrix: the products of (1, x, y, z) by each other. */
typedef struct {
    float one, x, y, z, xx, xy, xz, yy, yz, zz;
} dpi_block_t;

typedef struct {
    dpi_block_t diagonal[3]; /**< weighted by g_x g_x, g_y g_y, g_z g_z */
    dpi_block_t beside[3];   /**< weighted by g_x g_y, g_y g_z, g_z g_x */
    float target[3][4];      /**< sums of g_i (1, x, y, z) */
    float anchor[3];         /**< what x, y, z are relative to [counts] */
    float unit;              /**< half of the widest range of x, y, z [counts] */
    uint16_t count;
} dpi_sums_t;

/** Both sensors at one instant. */
typedef struct {
    float g[3]; /**< gravity [g] */
    float u[3]; /**< the magnetometer, relative to the anchor [counts] */
} dpi_row_t;

/**
 * Add rows to the 72 sums, one after the other.
 *
 * @param rows what to add
 * @param count of rows, at least one
 * @param sums the sums so far; anchor, unit and count are not looked at
 */
void dpi_add_rows(const dpi_row_t *rows, uint32_t count, dpi_sums_t *sums);

/** Sum over pairs, about the middle of the magnetometer's range. */
void dpi_sum_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, dpi_sums_t *sums);

/** Sum over still poses likewise. */
void dpi_sum_poses(const dpi_poses_t *poses, const dpi_known_t *known, dpi_sums_t *sums);

#endif
