/**
 * @file calibrator_table.h
 * @brief The calibrators this firmware offers: one line each, the name on the link and the function.
 */
#ifndef HILTEST_CALIBRATOR_TABLE_H
#define HILTEST_CALIBRATOR_TABLE_H

#define CALIBRATOR_TABLE(LINE)                 \
    LINE("direct", magnetometer_direct)        \
    LINE("direct-fast", magnetometer_direct_fast) \
    LINE("corrected", magnetometer_corrected)  \
    LINE("iterative", magnetometer_iterative)  \
    LINE("inverse-iteration", magnetometer_inverse_iteration) \
    LINE("li", magnetometer_li)                \
    LINE("gauss-newton", magnetometer_gauss_newton) \
    LINE("gradient-descent", magnetometer_gradient_descent)

#endif
