/* Distance field of the search: the function `_tile_values` of `distance_field.py` in C.
 *
 * Sums and products are evaluated in the order of the twins, so the results are equal to the last bit. Only guesses
 * depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

#define TILE 32       /* grid points along the side of a tile */
#define ROUNDING 1e-9 /* [m]: more than the rounding of heights and distances */

/* The larger and the smaller of two numbers; the field contains no NaN. */
static double larger(double a, double b) { return a > b ? a : b; }

static double smaller(double a, double b) { return a < b ? a : b; }

/* Signed distance of a point from an axis-aligned box, at most `nearest`. */
static double to_box(double px, double py, const double *low, const double *high, double nearest)
{
    double x = larger(low[0] - px, px - high[0]), y = larger(low[1] - py, py - high[1]);
    double right = larger(x, 0.0), up = larger(y, 0.0);
    if (larger(x, y) >= nearest)
        return nearest; /* the distance is not smaller */
    return smaller(nearest, sqrt(right * right + up * up) + smaller(larger(x, y), 0.0));
}

/* Distance of a point from a polygon with k corners, negative inside, at most `nearest`: vertices and normals (k, 2),
 * offsets (k,). */
static double to_polygon(double x, double y, int64_t k, const double *vertices, const double *normals,
                         const double *offsets, double nearest)
{
    double squared = INFINITY, height = -INFINITY;
    for (int64_t i = 0; i < k; i++) {
        height = larger(height, normals[2 * i] * x + normals[2 * i + 1] * y - offsets[i]);
        if (height > nearest + ROUNDING)
            return nearest; /* the distance is not smaller */
    }
    for (int64_t i = 0; i < k; i++) {
        const double *p = vertices + 2 * i, *q = vertices + 2 * ((i + 1) % k);
        double ex = q[0] - p[0], ey = q[1] - p[1];
        double share = ((x - p[0]) * ex + (y - p[1]) * ey) / larger(ex * ex + ey * ey, 1e-300);
        share = smaller(larger(share, 0.0), 1.0);
        double dx = x - p[0] - share * ex, dy = y - p[1] - share * ey;
        squared = smaller(squared, dx * dx + dy * dy);
    }
    return smaller(nearest, height < 0.0 ? -sqrt(squared) : sqrt(squared));
}

/* Compute the values of tiles.
 *
 *   n, tiles, m, k       numbers of tiles to compute, of tiles along a side, of obstacles and of their corners
 *   spacing, reach       of the grid, largest value [m]
 *   which                (n,), numbers of the tiles
 *   origin               (2,), the first grid point [m]
 *   is_box               (m,), 1 for axis-aligned rectangles, otherwise 0
 *   low, high            (m, 2); vertices, normals: (m, k, 2); offsets: (m, k)
 *   values               out, (n, TILE, TILE) [m] */
int64_t optdock_tile_values(int64_t n, int64_t tiles, int64_t m, int64_t k, double spacing, double reach,
                            const int64_t *which, const double *origin, const int64_t *is_box, const double *low,
                            const double *high, const double *vertices, const double *normals, const double *offsets,
                            double *values)
{
    for (int64_t t = 0; t < n; t++, values += TILE * TILE) {
        double axes[2][TILE];
        for (int64_t i = 0; i < TILE; i++) {
            axes[0][i] = origin[0] + (double)(which[t] / tiles * TILE + i) * spacing;
            axes[1][i] = origin[1] + (double)(which[t] % tiles * TILE + i) * spacing;
        }
        for (int64_t i = 0; i < TILE * TILE; i++)
            values[i] = reach;
        for (int64_t o = 0; o < m; o++) {
            const double *lower = low + 2 * o, *upper = high + 2 * o;
            if (!(lower[0] <= axes[0][TILE - 1] + reach && upper[0] >= axes[0][0] - reach &&
                  lower[1] <= axes[1][TILE - 1] + reach && upper[1] >= axes[1][0] - reach))
                continue;
            for (int64_t i = 0; i < TILE * TILE; i++) {
                double x = axes[0][i / TILE], y = axes[1][i % TILE];
                values[i] = is_box[o] ? to_box(x, y, lower, upper, values[i])
                                      : to_polygon(x, y, k, vertices + 2 * k * o, normals + 2 * k * o, offsets + k * o,
                                                   values[i]);
            }
        }
    }
    return 0;
}
