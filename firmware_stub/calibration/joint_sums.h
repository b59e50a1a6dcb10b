/**
 * @file joint_sums.h
 * @brief The 66 sums of a step of `joint`, 22 for each component of t; the others of its 90 follow from `t . u = 0` and `|u| = 1`.
 */
#ifndef HILTEST_JOINT_SUMS_H
#define HILTEST_JOINT_SUMS_H

#include "gravity_row.h"

/** Sums over pairs for component i; n is the next component in cyclic order, o the third. */
typedef struct {
    float one, n, o, nn, no;                      /**< weighted by t_i t_i: of u_n, u_o and their products */
    float b_one, x, y, z, xx, xy, xz, yy, yz;     /**< weighted by t_i t_n */
    float border[4];                              /**< p_i (1, x, y, z) */
    float target[4];                              /**< h_i (1, x, y, z) */
} joint_component_t;

typedef struct {
    joint_component_t components[3];
    float dots;    /**< sum of g . u */
    float squares; /**< sum of (g . u)^2 + |p|^2 (|f| - 1)^2 */
} joint_sums_t;

/** A pair, as joint.h has it. */
typedef struct {
    float u[3], t[3];
    float p_h[3][2]; /**< components of p and h */
} joint_row_t;

/** How many rows are made before they are added: to load and store the sums takes 230 cycles, whatever their number. */
#define JOINT_ROWS 50u

/** The data of rows, and the sums of a block of them. */
typedef struct {
    gravity_t gravity;
    float x[12]; /**< `f_r = x[4 r] + x[4 r + 1 ..] . counts` */
    float dots, squares; /**< see joint_sums_t */
} joint_task_t;

/**
 * Make rows.
 *
 * @param task its dots and squares are added to
 * @param magnetometer, accelerometer pairs [counts]
 * @param count of pairs, at least one
 * @param[out] rows of the pairs
 */
void joint_make_rows(joint_task_t *task, const int16_t (*magnetometer)[3], const int16_t (*accelerometer)[3], uint32_t count,
                     joint_row_t *rows);

/**
 * Add rows to the sums of all components, one after the other.
 *
 * @param rows what to add
 * @param count of rows, at least one
 * @param components the sums so far
 */
void joint_add_rows(const joint_row_t *rows, uint32_t count, joint_component_t components[3]);

/**
 * Sum over pairs.
 *
 * @param x 12 unknowns, see joint_task_t
 * @param[out] rows room for them
 */
void joint_sum_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, const float x[12], joint_row_t rows[JOINT_ROWS],
                     joint_sums_t *sums);

#endif
