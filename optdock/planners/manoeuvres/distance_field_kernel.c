/* Distance field of the search: the functions `_tile_values` and `disc_states` of `distance_field.py` in C.
 *
 * Sums and products are evaluated in the order of the twins, so the results are equal to the last bit. Only guesses
 * depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

#define TILE 32 /* grid points along the side of a tile */

/* The larger and the smaller of two numbers; the field contains no NaN. */
static double larger(double a, double b) { return a > b ? a : b; }

static double smaller(double a, double b) { return a < b ? a : b; }

/* Signed distance of a point from an axis-aligned box. */
static double to_box(double px, double py, const double *low, const double *high)
{
    double x = larger(low[0] - px, px - high[0]), y = larger(low[1] - py, py - high[1]);
    double right = larger(x, 0.0), up = larger(y, 0.0);
    return sqrt(right * right + up * up) + smaller(larger(x, y), 0.0);
}

/* Distance of a point from a polygon with k corners, negative inside: vertices and normals (k, 2), offsets (k,). */
static double to_polygon(double x, double y, int64_t k, const double *vertices, const double *normals,
                         const double *offsets)
{
    double squared = INFINITY, height = -INFINITY;
    for (int64_t i = 0; i < k; i++) {
        const double *p = vertices + 2 * i, *q = vertices + 2 * ((i + 1) % k);
        double ex = q[0] - p[0], ey = q[1] - p[1];
        double share = ((x - p[0]) * ex + (y - p[1]) * ey) / larger(ex * ex + ey * ey, 1e-300);
        share = smaller(larger(share, 0.0), 1.0);
        double dx = x - p[0] - share * ex, dy = y - p[1] - share * ey;
        squared = smaller(squared, dx * dx + dy * dy);
        height = larger(height, normals[2 * i] * x + normals[2 * i + 1] * y - offsets[i]);
    }
    return height < 0.0 ? -sqrt(squared) : sqrt(squared);
}

/* Compute the values of a tile.
 *
 *   boxes, polygons, k   numbers of obstacles of either kind, and of the corners of the polygons
 *   reach                largest value [m]
 *   axes                 (TILE, 2), x and y of the grid points
 *   low, high            (boxes, 2)
 *   vertices, normals    (polygons, k, 2); offsets: (polygons, k)
 *   values               out, (TILE, TILE) [m] */
int64_t optdock_tile_values(int64_t boxes, int64_t polygons, int64_t k, double reach, const double *axes,
                            const double *low, const double *high, const double *vertices, const double *normals,
                            const double *offsets, double *values)
{
    for (int64_t i = 0; i < TILE; i++) {
        for (int64_t j = 0; j < TILE; j++) {
            double x = axes[2 * i], y = axes[2 * j + 1], nearest = reach;
            for (int64_t o = 0; o < boxes; o++)
                nearest = smaller(nearest, to_box(x, y, low + 2 * o, high + 2 * o));
            for (int64_t o = 0; o < polygons; o++)
                nearest = smaller(nearest, to_polygon(x, y, k, vertices + 2 * k * o, normals + 2 * k * o,
                                                      offsets + k * o));
            values[TILE * i + j] = nearest;
        }
    }
    return 0;
}

/* The grid: number of tiles along a side, spacing and first point [m], index of the values of every tile. */
typedef struct {
    int64_t tiles;
    double spacing, x, y;
    int64_t *slots;       /* (tiles, tiles); -1: not computed yet, -2: in the list of missing tiles */
    const double *values; /* (computed tiles, TILE, TILE) [m] */
} Field;

/* Bounds of the distance of a point [m]; the lower bound is -inf outside the field. */
typedef struct {
    double lower, upper;
} Bounds;

/* A cell of the grid; NaN becomes 0. */
static double clamped(double cell, double last) { return cell > last ? last : cell > 0.0 ? cell : 0.0; }

/* Return 0 if the tile of the point is missing, and append it to the list unless it is there already. */
static int bounds_at(const Field *field, double px, double py, int64_t *missing, int64_t *count, Bounds *bounds)
{
    double last = (double)(TILE * field->tiles - 1);
    double u = (px - field->x) / field->spacing, v = (py - field->y) / field->spacing;
    double column = rint(u), row = rint(v);
    int is_inside = column >= 0.0 && column <= last && row >= 0.0 && row <= last;
    int64_t i = (int64_t)clamped(column, last), j = (int64_t)clamped(row, last);
    int64_t tile = i / TILE * field->tiles + j / TILE, slot = field->slots[tile];
    if (slot < 0) {
        if (slot == -1)
            missing[(*count)++] = tile;
        field->slots[tile] = -2;
        return 0;
    }
    double distance = field->values[TILE * TILE * slot + TILE * (i % TILE) + j % TILE];
    double du = u - column, dv = v - row, away = field->spacing * sqrt(du * du + dv * dv);
    *bounds = (Bounds){is_inside ? distance - away : -INFINITY, distance + away};
    return 1;
}

/* Compare discs of n poses with the field (R6, docs/theory/search.md).
 *
 *   n, discs, tiles   numbers of poses, of discs and of tiles along a side
 *   spacing, x, y     see `Field`
 *   poses             (n, 3); turned: (n, 2), cosine and sine of the headings
 *   required          (n,) [m]
 *   circles           (4, discs): x, y, radius that covers, radius inside [m]
 *   slots, values     see `Field`
 *   states            out, (n,): 1 if the discs prove the clearance, 2 if they exclude it, 4 if outside the field, added
 *   missing           out, (tiles * tiles,): tiles that must be computed first
 *
 * Return the number of missing tiles; unless it is 0, the states are not valid. */
int64_t optdock_disc_states(int64_t n, int64_t discs, int64_t tiles, double spacing, double x, double y,
                            const double *poses, const double *turned, const double *required, const double *circles,
                            int64_t *slots, const double *values, int64_t *states, int64_t *missing)
{
    Field field = {tiles, spacing, x, y, slots, values};
    int64_t count = 0;
    for (int64_t i = 0; i < n; i++) {
        double c = turned[2 * i], s = turned[2 * i + 1], lowest = INFINITY, highest = INFINITY;
        for (int64_t d = 0; d < discs; d++) {
            double cx = circles[d], cy = circles[discs + d];
            double px = poses[3 * i] + c * cx - s * cy, py = poses[3 * i + 1] + s * cx + c * cy;
            Bounds bounds;
            if (!bounds_at(&field, px, py, missing, &count, &bounds))
                continue;
            lowest = smaller(lowest, bounds.lower - circles[2 * discs + d]);
            highest = smaller(highest, bounds.upper - circles[3 * discs + d]);
        }
        states[i] = (lowest >= required[i]) + 2 * (highest < required[i]) + 4 * (lowest == -INFINITY);
    }
    return count;
}
