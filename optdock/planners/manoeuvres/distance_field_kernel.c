/* Distance field of the search: the function `_tile_values` of `distance_field.py` in C.
 *
 * Sums and products are evaluated in the order of the twins, so the results are equal to the last bit. Only guesses
 * depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

#define TILE 32       /* grid points along the side of a tile */
#define BLOCK 8       /* grid points along the side of a block of a tile */
#define CHUNK 256     /* obstacles that are compared with the blocks of a tile at once */
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

/* The obstacles; see `optdock_tile_values`. */
typedef struct {
    int64_t k; /* corners of an obstacle */
    const double *low, *high, *vertices, *normals, *offsets;
} Rocks;

/* Whether an obstacle is an axis-aligned rectangle: its vertices are corners of its box, and no edge is diagonal. */
static int is_box(const Rocks *rocks, int64_t o)
{
    const double *low = rocks->low + 2 * o, *high = rocks->high + 2 * o, *vertices = rocks->vertices + 2 * rocks->k * o;
    for (int64_t i = 0; i < rocks->k; i++) {
        const double *p = vertices + 2 * i, *q = vertices + 2 * ((i + 1) % rocks->k);
        if ((p[0] != low[0] && p[0] != high[0]) || (p[1] != low[1] && p[1] != high[1]) || (p[0] != q[0] && p[1] != q[1]))
            return 0;
    }
    return 1;
}

/* Lower the values of a block, whose first point is `values`, to the distances from an obstacle. Return the largest. */
static double lowered(const Rocks *rocks, int64_t o, const double *xs, const double *ys, double *values)
{
    const double *low = rocks->low + 2 * o, *high = rocks->high + 2 * o, *vertices = rocks->vertices + 2 * rocks->k * o;
    const double *normals = rocks->normals + 2 * rocks->k * o, *offsets = rocks->offsets + rocks->k * o;
    double largest = -INFINITY;
    int by_box = is_box(rocks, o);
    for (int64_t i = 0; i < BLOCK; i++) {
        for (int64_t j = 0; j < BLOCK; j++) {
            double *value = values + TILE * i + j;
            *value = by_box ? to_box(xs[i], ys[j], low, high, *value)
                                      : to_polygon(xs[i], ys[j], rocks->k, vertices, normals, offsets, *value);
            largest = larger(largest, *value);
        }
    }
    return largest;
}

/* Lower the values of a block to the distances from some obstacles, (count,), the nearest one first. No point of
 * the block is nearer to an obstacle than the gap between the block and the rectangle around the obstacle, if there is
 * one; points inside several obstacles are compared with all of them. */
static void lower_block(const Rocks *rocks, const int64_t *rows, int64_t count, const double *xs, const double *ys,
                        double *values)
{
    double gaps[CHUNK], largest = INFINITY;
    int64_t first = 0;
    for (int64_t i = 0; i < count; i++) {
        const double *low = rocks->low + 2 * rows[i], *high = rocks->high + 2 * rows[i];
        double x = larger(larger(low[0] - xs[BLOCK - 1], xs[0] - high[0]), 0.0);
        double y = larger(larger(low[1] - ys[BLOCK - 1], ys[0] - high[1]), 0.0);
        gaps[i] = sqrt(x * x + y * y);
        first = gaps[i] < gaps[first] ? i : first;
    }
    for (int64_t i = 0; i <= count; i++) {
        int64_t row = i == 0 ? first : i - 1;
        if ((gaps[row] > 0.0 && gaps[row] > largest + ROUNDING) || (i > 0 && row == first))
            continue;
        largest = lowered(rocks, rows[row], xs, ys, values);
    }
}

/* Lower the values of a tile to the distances from some obstacles, (count,). */
static void lower_tile(const Rocks *rocks, const int64_t *rows, int64_t count, const double *xs, const double *ys,
                       double *values)
{
    for (int64_t i = 0; count > 0 && i < TILE; i += BLOCK)
        for (int64_t j = 0; j < TILE; j += BLOCK)
            lower_block(rocks, rows, count, xs + i, ys + j, values + TILE * i + j);
}

/* Compute the values of tiles.
 *
 *   n, tiles, m, k       numbers of tiles to compute, of tiles along a side, of obstacles and of their corners
 *   spacing, reach       of the grid, largest value [m]
 *   which                (n,), numbers of the tiles
 *   origin               (2,), the first grid point [m]
 *   vertices, normals    (m, k, 2); offsets: (m, k); low, high: (m, 2)
 *   values               out, (n, TILE, TILE) [m] */
int64_t optdock_tile_values(int64_t n, int64_t tiles, int64_t m, int64_t k, double spacing, double reach,
                            const int64_t *which, const double *origin, const double *vertices, const double *normals,
                            const double *offsets, const double *low, const double *high, double *values)
{
    Rocks rocks = {k, low, high, vertices, normals, offsets};
    for (int64_t t = 0; t < n; t++, values += TILE * TILE) {
        double axes[2][TILE];
        for (int64_t i = 0; i < TILE; i++) {
            axes[0][i] = origin[0] + (double)(which[t] / tiles * TILE + i) * spacing;
            axes[1][i] = origin[1] + (double)(which[t] % tiles * TILE + i) * spacing;
        }
        for (int64_t i = 0; i < TILE * TILE; i++)
            values[i] = reach;
        int64_t rows[CHUNK], count = 0;
        for (int64_t o = 0; o < m; o++) {
            const double *lower = low + 2 * o, *upper = high + 2 * o;
            if (!(lower[0] <= axes[0][TILE - 1] + reach && upper[0] >= axes[0][0] - reach &&
                  lower[1] <= axes[1][TILE - 1] + reach && upper[1] >= axes[1][0] - reach))
                continue;
            if (count == CHUNK) {
                lower_tile(&rocks, rows, count, axes[0], axes[1], values);
                count = 0;
            }
            rows[count++] = o;
        }
        lower_tile(&rocks, rows, count, axes[0], axes[1], values);
    }
    return 0;
}

/* Compute the values of a tile for another kernel, unless the limit of its call is reached.
 *
 *   progress             in and out, (3,): another number, the number of tiles that have values, and its limit
 *   slots                in and out, (tiles, tiles), index of the values of every tile; -1: not computed yet
 *   values               in and out, (tiles for which there is room, TILE, TILE) [m]
 *   shape                (3,): tiles, m and k; grid: (4,): spacing, first grid point and reach [m]
 *   vertices ... high    as above
 *
 * Return whether the tile has values now. */
int64_t optdock_add_tile(int64_t tile, int64_t *progress, int64_t *slots, double *values, const int64_t *shape,
                         const double *grid, const double *vertices, const double *normals, const double *offsets,
                         const double *low, const double *high)
{
    if (progress[1] == progress[2])
        return 0;
    optdock_tile_values(1, shape[0], shape[1], shape[2], grid[0], grid[3], &tile, grid + 1, vertices, normals, offsets,
                        low, high, values + TILE * TILE * progress[1]);
    slots[tile] = progress[1]++;
    return 1;
}
