/* Covariances of the pose filter: the functions `grown` and `corrected` of `pose_filter.py` in C.
 *
 * The state is x, y, yaw, scale, drift and delay. Sums are in another order than in the twins, so the results are equal
 * up to rounding. */

#include <math.h>
#include <stdint.h>

/* The covariance (6, 6) after a step of odometry.
 *
 *   cosine, sine   of the heading in the middle of the step
 *   x, y           displacement in the fixed frame [m]
 *   way            distance along the heading [m]
 *   covariance     (6, 6), before the step
 *   added          (3,): variances added along the heading, to x and y each, and to yaw
 *   out            out, (6, 6)
 *
 * Return 6. */
int64_t optdock_grown_covariance(double cosine, double sine, double x, double y, double way, const double *covariance,
                                 const double *added, double *out)
{
    double half[6][6];
    for (int j = 0; j < 6; j++) {
        for (int i = 0; i < 6; i++)
            half[i][j] = covariance[6 * i + j];
        half[0][j] += -y * covariance[12 + j] + cosine * way * covariance[18 + j];
        half[1][j] += x * covariance[12 + j] + sine * way * covariance[18 + j];
        half[2][j] += way * covariance[24 + j];
    }
    for (int i = 0; i < 6; i++) {
        for (int j = 3; j < 6; j++)
            out[6 * i + j] = half[i][j];
        out[6 * i] = half[i][0] - y * half[i][2] + cosine * way * half[i][3];
        out[6 * i + 1] = half[i][1] + x * half[i][2] + sine * way * half[i][3];
        out[6 * i + 2] = half[i][2] + way * half[i][4];
    }
    out[0] += cosine * cosine * added[0] + added[1];
    out[7] += sine * sine * added[0] + added[1];
    out[1] += cosine * sine * added[0];
    out[6] += cosine * sine * added[0];
    out[14] += added[2];
    return 6;
}

/* The inverse W of the Cholesky factor of a covariance, W' W = inverse of `spread`. Returns whether it exists. */
static int whiten(double spread[3][3], double white[3][3])
{
    double first = sqrt(spread[0][0]), b = spread[1][0] / first, c = spread[2][0] / first;
    double second = sqrt(spread[1][1] - b * b), e = (spread[2][1] - b * c) / second;
    double third = sqrt(spread[2][2] - c * c - e * e), lower = -b / (first * second);
    if (!(first > 0.0 && second > 0.0 && third > 0.0))
        return 0;
    double found[3][3] = {{1.0 / first, 0.0, 0.0},
                          {lower, 1.0 / second, 0.0},
                          {-(c / first + e * lower) / third, -e / (second * third), 1.0 / third}};
    for (int i = 0; i < 9; i++)
        white[i / 3][i % 3] = found[i / 3][i % 3];
    return 1;
}

/* Correct a state by a measured pose, in the form of Joseph.
 *
 *   jitter        standard deviation of the time of the measurement [s]
 *   covariance    (6, 6)
 *   noise         (3, 3), of the measured pose
 *   measured      (8,): lever of the yaw in x and y [m]; velocity in the fixed frame; measured minus expected pose
 *   out           out: covariance, (6, 6); change of the state, (6,); whitened innovation, (3,)
 *
 * Return 6, or -1 if the covariance of the innovation is not positive definite. */
int64_t optdock_corrected_state(double jitter, const double *covariance, const double *noise, const double *measured,
                                double *out)
{
    const double *lever = measured, *velocity = measured + 2, *miss = measured + 5;
    double seen[3][6] = {{0.0}}, all_noise[3][3], shared[3][6], spread[3][3], white[3][3];
    for (int i = 0; i < 3; i++) {
        seen[i][i] = 1.0;
        if (i < 2)
            seen[i][2] = lever[i];
        seen[i][5] = -velocity[i];
        for (int j = 0; j < 3; j++)
            all_noise[i][j] = noise[3 * i + j] + jitter * jitter * (velocity[i] * velocity[j]);
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 6; j++) {
            shared[i][j] = 0.0;
            for (int k = 0; k < 6; k++)
                shared[i][j] += seen[i][k] * covariance[6 * k + j];
        }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            spread[i][j] = all_noise[i][j];
            for (int k = 0; k < 6; k++)
                spread[i][j] += shared[i][k] * seen[j][k];
        }
    if (!whiten(spread, white))
        return -1;
    double white_shared[3][6] = {{0.0}}, *change = out + 36, *whitened = out + 42;
    for (int i = 0; i < 3; i++) {
        whitened[i] = white[i][0] * miss[0] + white[i][1] * miss[1] + white[i][2] * miss[2];
        for (int j = 0; j < 6; j++)
            for (int k = 0; k <= i; k++)
                white_shared[i][j] += white[i][k] * shared[k][j];
    }
    double gain[6][3], rest[6][6], half[6][6];
    for (int i = 0; i < 6; i++) {
        change[i] = 0.0;
        for (int k = 0; k < 3; k++)
            change[i] += white_shared[k][i] * whitened[k];
        for (int j = 0; j < 3; j++) {
            gain[i][j] = 0.0;
            for (int k = j; k < 3; k++)
                gain[i][j] += white_shared[k][i] * white[k][j];
        }
        for (int j = 0; j < 6; j++) {
            rest[i][j] = i == j ? 1.0 : 0.0;
            for (int k = 0; k < 3; k++)
                rest[i][j] -= gain[i][k] * seen[k][j];
        }
    }
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            half[i][j] = 0.0;
            for (int k = 0; k < 6; k++)
                half[i][j] += rest[i][k] * covariance[6 * k + j];
        }
    for (int i = 0; i < 6; i++) {
        double noisy[3];
        for (int j = 0; j < 3; j++)
            noisy[j] = gain[i][0] * all_noise[0][j] + gain[i][1] * all_noise[1][j] + gain[i][2] * all_noise[2][j];
        for (int j = 0; j < 6; j++) {
            double sum = 0.0;
            for (int k = 0; k < 6; k++)
                sum += half[i][k] * rest[j][k];
            out[6 * i + j] = sum + (noisy[0] * gain[j][0] + noisy[1] * gain[j][1] + noisy[2] * gain[j][2]);
        }
    }
    return 6;
}
