/* Shortest routes of a disc on the grid of the distance field: `_spread`, `_way_back` and `_pulled` of `disc_routes.py`
 * in C (R8, docs/theory/search.md).
 *
 * Sums and products are evaluated in the order of the twins, so the results are equal to the last bit. Only guesses
 * depend on this file; the certificate has code of its own. */

#include <math.h>
#include <stdint.h>

#define TILE 32 /* grid points along the side of a tile */

/* Of `distance_field_kernel.c`. */
int64_t optdock_add_tile(int64_t tile, int64_t *progress, int64_t *slots, double *values, const int64_t *shape,
                         const double *grid, const double *vertices, const double *normals, const double *offsets,
                         const double *low, const double *high);

/* The distance field: see `optdock_add_tile`; is_short: whether a tile has no values, for which the call ends. */
typedef struct {
    int64_t *progress, *slots;
    double *values;
    const int64_t *shape;
    const double *grid, *vertices, *normals, *offsets, *low, *high;
    int is_short;
} Field;

#define FIELD_PARAMETERS                                                                                               \
    int64_t *progress, int64_t *slots, double *values, const int64_t *shape, const double *grid,                       \
        const double *vertices, const double *normals, const double *offsets, const double *low, const double *high
#define FIELD                                                                                                          \
    (Field) { progress, slots, values, shape, grid, vertices, normals, offsets, low, high, 0 }

static const int64_t AROUND[8][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {1, -1}, {-1, 1}, {-1, -1}};

static double larger(double a, double b) { return a > b ? a : b; }

/* Distance at a grid point [m], or NaN if its tile has no values. */
static double value_at(Field *field, int64_t i, int64_t j)
{
    int64_t tile = i / TILE * field->shape[0] + j / TILE;
    if (field->slots[tile] < 0 &&
        !optdock_add_tile(tile, field->progress, field->slots, field->values, field->shape, field->grid,
                          field->vertices, field->normals, field->offsets, field->low, field->high)) {
        field->is_short = 1;
        return NAN;
    }
    return field->values[TILE * TILE * field->slots[tile] + TILE * (i % TILE) + j % TILE];
}

/* Advance a wave by one cell from the front, the cells from `begin` to `end` of the queue, and return the new end. If
 * tiles are missing, the wave is not changed. */
static int64_t advance(Field *field, double beside, double radius, int64_t count, double *steps, int64_t *queue,
                       int64_t begin, int64_t end)
{
    int64_t side = TILE * field->shape[0], ways = count % 2 ? 4 : 8, last = end;
    for (int64_t q = begin; q < end; q++) {
        int64_t row = queue[q] / side, column = queue[q] % side;
        for (int64_t way = 0; way < ways; way++) {
            int64_t i = row + AROUND[way][0], j = column + AROUND[way][1];
            if (i < 0 || i >= side || j < 0 || j >= side || steps[side * i + j] != 0.0)
                continue;
            if (value_at(field, i, j) + beside >= radius) {
                steps[side * i + j] = (double)(count + 2);
                queue[last++] = side * i + j;
            }
        }
    }
    while (field->is_short && last > end)
        steps[queue[--last]] = 0.0;
    return last;
}

/* Spread a wave over the grid until all targets are reached.
 *
 *   targets, most   numbers of targets, and of steps after which the call ends
 *   beside, radius  [m]: the disc fits at a grid point if its value plus `beside` is at least the radius
 *   cells           (targets,), grid points
 *   steps           in and out, (side, side), 0 if not reached, otherwise 1 + the number of steps
 *   queue           in and out, (side side,), cells in the order in which they are reached
 *   front           in and out, (2,): begin and end of the front in the queue
 *   progress        in and out, (3,): number of steps; tiles, see `optdock_add_tile`, as the next
 *
 * Return 1 if all targets are reached or the wave has ended, otherwise 0. */
int64_t optdock_spread(int64_t targets, int64_t most, double beside, double radius, const int64_t *cells, double *steps,
                       int64_t *queue, int64_t *front, FIELD_PARAMETERS)
{
    Field field = FIELD;
    int64_t reached = 0;
    for (int64_t k = 0; k < most; k++) {
        while (reached < targets && steps[cells[reached]] != 0.0)
            reached++;
        if (reached == targets || front[0] == front[1])
            return 1;
        int64_t last = advance(&field, beside, radius, progress[0], steps, queue, front[0], front[1]);
        if (field.is_short)
            break;
        front[0] = front[1];
        front[1] = last;
        progress[0]++;
    }
    return 0;
}

/* Follow a wave back from a cell to its source.
 *
 *   side, most   grid points along a side, length of `way`
 *   cell         the cell, which the wave has reached
 *   steps        (side, side), see `optdock_spread`
 *   way          out, (most,), the cells from the source
 *
 * Return the number of cells, which is 0 if there are more than `most`. */
int64_t optdock_way_back(int64_t side, int64_t most, int64_t cell, const double *steps, int64_t *way)
{
    int64_t count = 0;
    while (count < most) {
        way[count++] = cell;
        if (steps[cell] == 1.0)
            break;
        int64_t i = cell / side, j = cell % side;
        double least = INFINITY;
        for (int64_t k = 0; k < 8; k++) {
            int64_t row = i + AROUND[k][0], column = j + AROUND[k][1];
            row = row < 0 ? 0 : row < side ? row : side - 1;
            column = column < 0 ? 0 : column < side ? column : side - 1;
            double step = steps[side * row + column];
            if (step > 0.0 && step < least) {
                least = step;
                cell = side * row + column;
            }
        }
    }
    if (steps[way[count - 1]] != 1.0)
        return 0;
    for (int64_t k = 0; k < count / 2; k++) {
        int64_t other = way[k];
        way[k] = way[count - 1 - k];
        way[count - 1 - k] = other;
    }
    return count;
}

/* A cell of the grid; NaN becomes 0. */
static double clamped(double cell, double last) { return cell > last ? last : cell > 0.0 ? cell : 0.0; }

/* Mean of the bounds of the distance of a point [m], -inf outside the field, NaN if its tile has no values. */
static double distance_at(Field *field, double x, double y)
{
    double spacing = field->grid[0], last = (double)(TILE * field->shape[0] - 1);
    double u = (x - field->grid[1]) / spacing, v = (y - field->grid[2]) / spacing;
    double column = rint(u), row = rint(v), du = u - column, dv = v - row;
    double value = value_at(field, (int64_t)clamped(column, last), (int64_t)clamped(row, last));
    double away = spacing * sqrt(du * du + dv * dv);
    int is_inside = column >= 0.0 && column <= last && row >= 0.0 && row <= last;
    return 0.5 * ((is_inside ? value - away : -INFINITY) + (value + away));
}

/* Straighten a route and move it away from obstacles; one iteration per element of `damped`, from `done` on.
 *
 *   n, pulls         numbers of points and of iterations
 *   step             of the differences of the distance [m]
 *   room, stiffness  distance to keep [m], share of the way of a full step
 *   damped           (pulls,)
 *   points           in and out, (n, 2) [m]; moved: work, (n, 2)
 *   progress         in and out, (3,): iterations done; tiles, see `optdock_add_tile`, as the next */
int64_t optdock_pulled(int64_t n, int64_t pulls, double step, double room, double stiffness, const double *damped,
                       double *points, double *moved, FIELD_PARAMETERS)
{
    Field field = FIELD;
    for (; progress[0] < pulls; progress[0]++) {
        for (int64_t i = 1; i < n - 1; i++) {
            const double *at = points + 2 * i;
            double near[5];
            for (int64_t k = 0; k < 5; k++) { /* here, then to both sides in x and in y */
                double dx = k == 1 ? step : k == 2 ? -step : 0.0, dy = k == 3 ? step : k == 4 ? -step : 0.0;
                near[k] = distance_at(&field, at[0] + dx, at[1] + dy);
            }
            double push = stiffness * larger(room - near[0], 0.0);
            for (int64_t k = 0; k < 2; k++) {
                double slope = (near[1 + 2 * k] - near[2 + 2 * k]) / (2.0 * step);
                double pulled = stiffness * (0.5 * (at[k - 2] + at[k + 2]) - at[k]);
                moved[2 * i + k] = at[k] + damped[progress[0]] * (pulled + push * slope);
            }
        }
        if (field.is_short)
            break;
        for (int64_t k = 2; k < 2 * (n - 1); k++)
            points[k] = moved[k];
    }
    return 0;
}
