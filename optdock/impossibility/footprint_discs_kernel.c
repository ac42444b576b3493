/* Discs within an outline: the functions `_depth` and `_covered` of `footprint_discs.py` in C.
 *
 * Only the search for a proof depends on this file; the checker computes the depths of the discs itself. Sums and
 * products are evaluated in the order of the twins, so the results are equal to the last bit. */

#include <math.h>
#include <stdint.h>

/* Compute the depth of points in a polygon.
 *
 *   n, corners      numbers of points and corners
 *   rounding        subtracted from the depths of points inside [m]
 *   points          (n, 2); outline: (corners, 2) [m]
 *   depth           out, (n,); minus the distance from the polygon for points outside [m] */
int64_t optdock_depths(int64_t n, int64_t corners, double rounding, const double *points, const double *outline,
                       double *depth)
{
    for (int64_t i = 0; i < n; i++) {
        double x = points[2 * i], y = points[2 * i + 1], nearest = INFINITY;
        int inside = 0;
        for (int64_t k = 0; k < corners; k++) {
            const double *start = outline + 2 * k, *end = outline + 2 * ((k + 1) % corners);
            double ex = end[0] - start[0], ey = end[1] - start[1], tx = x - start[0], ty = y - start[1];
            double along = (tx * ex + ty * ey) / (ex * ex + ey * ey);
            along = along < 0.0 ? 0.0 : along > 1.0 ? 1.0 : along;
            double dx = tx - along * ex, dy = ty - along * ey, squared = dx * dx + dy * dy;
            nearest = squared < nearest ? squared : nearest;
            if ((start[1] > y) != (end[1] > y) && x < start[0] + ty / ey * ex)
                inside = !inside;
        }
        depth[i] = inside ? sqrt(nearest) - rounding : -sqrt(nearest);
    }
    return 0;
}

/* Find the discs that cover samples of the outline: all within a tolerance, and the nearest one.
 *
 *   m, n         numbers of samples and discs
 *   tolerance    [m]
 *   samples      (m, 2); points: (n, 2), centres; radius: (n,) [m]
 *   covers       out, (m, n), 0 or 1 */
int64_t optdock_covered(int64_t m, int64_t n, double tolerance, const double *samples, const double *points,
                        const double *radius, int64_t *covers)
{
    for (int64_t i = 0; i < m; i++) {
        double least = INFINITY;
        int64_t nearest = 0;
        for (int64_t k = 0; k < n; k++) {
            double dx = samples[2 * i] - points[2 * k], dy = samples[2 * i + 1] - points[2 * k + 1];
            double gap = sqrt(dx * dx + dy * dy) - radius[k];
            covers[i * n + k] = gap <= tolerance;
            if (gap < least) {
                least = gap;
                nearest = k;
            }
        }
        covers[i * n + nearest] = 1;
    }
    return 0;
}
