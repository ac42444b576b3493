/* Iterations of the interior point method: the function `advanced` of `interior_point.py` in C.
 *
 * The program is (T8) and the step of Newton's method (T9) of docs/theory/timing.md. Sums are evaluated in the order of
 * the twin, so the iterates are equal to the last bit. A search for a motion uses them; the certificate does not. */

#include <math.h>
#include <stdint.h>

/* Numbers of cells, of rows of A, of rows of B, and of all rows. */
typedef struct {
    int64_t m, linear, curved, rows;
} Counts;

/* The program; see the class `Program`. Stencils are (3, rows, m). */
typedef struct {
    const double *steps, *linear, *curved, *places, *right_share, *quadratic;
} Program;

/* The iterate; see the class `Iterate`. Rows of A come before rows of B. */
typedef struct {
    double *c, *slack, *dual, *share;
} Iterate;

typedef struct {
    double least_share, gap, residual, to_boundary, largest_decrease;
    double long_step, long_share, middle_step, middle_share, short_share;
    double smallest_slack, first_gap;
} Settings;

enum { UPDATES = 8 }; /* iterations in which f is updated */

/* Values and changes of the constraints, and Newton's system. */
typedef struct {
    double *value, *weight, *centre; /* (rows, m): values of the constraints, Z / S, mu / S */
    double *slack_change, *dual_change; /* (rows, m) */
    double *stencil;              /* (3, curved, m), derivatives of the rows B */
    double *root, *cube;          /* (m,), sqrt(c) and step / sqrt(c)^3 */
    double *normal, *slope;       /* (6, m) and (3, m): A' W A and A' target as products of neighbouring columns */
    double *change;               /* (m + 2,) */
    double *product;              /* (m + 2,), Q c */
    double *factors;              /* (4, m), the factors of Newton's matrix, and the pivots */
} Work;

static double least(double a, double b) { return a < b || a != a ? a : b; }

static double most(double a, double b) { return a > b || a != a ? a : b; }

/* A row of a stencil, whose columns are `size` apart, applied to c in cell i. */
static double applied(const double *row, int64_t size, int64_t i, const double *c)
{
    return row[i] * c[i] + row[size + i] * c[i + 1] + row[2 * size + i] * c[i + 2];
}

/* f of the rows B. */
static void set_shares(Counts n, const Program *program, Settings settings, const double *c, double *share)
{
    for (int64_t i = 0; i < n.m; i++) {
        double left = c[i] + program->right_share[i] * (c[i + 1] - c[i]);
        double right = c[i + 1] + program->right_share[i + 1] * (c[i + 2] - c[i + 1]);
        double largest = sqrt(c[i + 1] / most(most(left, right), c[i + 1]));
        for (int64_t r = 0; r < 2; r++)
            share[r * n.m + i] = largest;
        for (int64_t r = 2; r < n.curved; r++) {
            double there = applied(program->places + (r - 2) * n.m, (n.curved - 2) * n.m, i, c);
            share[r * n.m + i] = sqrt(c[i + 1] / most(there, settings.least_share * c[i + 1]));
        }
    }
}

/* Values of all constraints, and the derivatives of the rows B. */
static void evaluate(Counts n, const Program *program, const Iterate *at, Work *work)
{
    for (int64_t i = 0; i < n.m; i++) {
        double root = sqrt(at->c[i + 1]);
        work->root[i] = root;
        work->cube[i] = program->steps[i] / (root * (root * root));
    }
    for (int64_t r = 0; r < n.linear; r++)
        for (int64_t i = 0; i < n.m; i++)
            work->value[r * n.m + i] = applied(program->linear + r * n.m, n.linear * n.m, i, at->c) - 1.0;
    int64_t size = n.curved * n.m;
    double *value = work->value + n.linear * n.m;
    for (int64_t r = 0; r < n.curved; r++) {
        for (int64_t i = 0; i < n.m; i++) {
            int64_t k = r * n.m + i;
            for (int64_t j = 0; j < 3; j++)
                work->stencil[j * size + k] = program->curved[j * size + k] * work->root[i];
            value[k] = applied(work->stencil + r * n.m, size, i, at->c) - at->share[k];
            work->stencil[size + k] += 0.5 * at->share[k] / (work->root[i] * work->root[i]);
        }
    }
}

/* Row r of the stencils of all constraints; size: distance of its columns. */
static const double *row_of(Counts n, const Program *program, const Work *work, int64_t r, int64_t *size)
{
    *size = (r < n.linear ? n.linear : n.curved) * n.m;
    return r < n.linear ? program->linear + r * n.m : work->stencil + (r - n.linear) * n.m;
}

/* Add row r with its weights and targets to Newton's system. */
static void add_row(Counts n, const Program *program, const Iterate *at, double mu, int64_t r, Work *work)
{
    int64_t size, m = n.m;
    const double *row = row_of(n, program, work, r, &size);
    double *normal = work->normal, *slope = work->slope;
    for (int64_t i = 0; i < m; i++) {
        int64_t k = r * m + i;
        double a = row[i], b = row[size + i], c = row[2 * size + i], slack = at->slack[k];
        double weight = at->dual[k] / slack, centre = mu / slack;
        double target = centre + weight * (work->value[k] + slack);
        work->weight[k] = weight;
        work->centre[k] = centre;
        normal[i] += weight * (a * a);
        normal[m + i] += weight * (b * b);
        normal[2 * m + i] += weight * (c * c);
        normal[3 * m + i] += weight * (a * b);
        normal[4 * m + i] += weight * (b * c);
        normal[5 * m + i] += weight * (a * c);
        slope[i] += target * a;
        slope[m + i] += target * b;
        slope[2 * m + i] += target * c;
    }
}

/* Q c, Q by its upper bands (4, count). */
static void band_product(int64_t count, const double *bands, const double *c, double *product)
{
    for (int64_t i = 0; i < count; i++)
        product[i] = bands[3 * count + i] * c[i];
    for (int64_t distance = 1; distance < 4; distance++) {
        const double *band = bands + (3 - distance) * count + distance;
        for (int64_t i = 0; i < count - distance; i++)
            product[i + distance] += band[i] * c[i];
        for (int64_t i = 0; i < count - distance; i++)
            product[i] += band[i] * c[i + distance];
    }
}

/* Solve Newton's system for change[2] to change[m - 1] by factors L D L'; zero if it is not positive definite.
 * Rows of `factors`: the entries of L one, two and three left of the diagonal, and D. */
static void solve_bands(Counts n, const Program *program, Work *work)
{
    int64_t m = n.m, count = m - 2;
    const double *q = program->quadratic + 2, *normal = work->normal, *slope = work->slope;
    double *a = work->factors, *b = a + m, *c = b + m, *pivots = c + m, *x = work->change + 2;
    for (int64_t j = 0; j < count; j++) {
        double third = q[j], second = q[m + 2 + j], first = q[2 * (m + 2) + j];
        double cube = work->cube[j + 1], square = work->root[j + 1] * work->root[j + 1];
        double own = q[3 * (m + 2) + j] +
                     (normal[j + 2] + normal[m + j + 1] + normal[2 * m + j] + 0.75 * cube / square);
        if (j >= 1)
            first += normal[3 * m + j + 1] + normal[4 * m + j];
        if (j >= 2)
            second += normal[5 * m + j];
        second -= third * (j >= 2 ? a[j - 2] : 0.0);
        first -= third * (j >= 1 ? b[j - 1] : 0.0) + second * (j >= 1 ? a[j - 1] : 0.0);
        c[j] = third / (j >= 3 ? pivots[j - 3] : INFINITY);
        b[j] = second / (j >= 2 ? pivots[j - 2] : INFINITY);
        a[j] = first / (j >= 1 ? pivots[j - 1] : INFINITY);
        pivots[j] = own - (third * c[j] + second * b[j] + first * a[j]);
        if (pivots[j] <= 0.0) {
            for (int64_t i = 0; i < count; i++)
                x[i] = 0.0;
            return;
        }
        double force = 0.5 * cube - (slope[j + 2] + slope[m + j + 1] + slope[2 * m + j]);
        force -= work->product[j + 2];
        x[j] = force - (a[j] * (j >= 1 ? x[j - 1] : 0.0) + b[j] * (j >= 2 ? x[j - 2] : 0.0) +
                        c[j] * (j >= 3 ? x[j - 3] : 0.0));
    }
    for (int64_t j = count - 1; j >= 0; j--)
        x[j] = x[j] / pivots[j] - ((j + 1 < count ? a[j + 1] * x[j + 1] : 0.0) +
                                   (j + 2 < count ? b[j + 2] * x[j + 2] : 0.0) +
                                   (j + 3 < count ? c[j + 3] * x[j + 3] : 0.0));
}

/* Set the change of the coefficients (T9). Return whether it is finite. */
static int newton_change(Counts n, const Program *program, const Iterate *at, double mu, Work *work)
{
    int64_t m = n.m;
    for (int64_t i = 0; i < 9 * m; i++)
        work->normal[i] = 0.0; /* and the slope */
    for (int64_t r = 0; r < n.rows; r++)
        add_row(n, program, at, mu, r, work);
    band_product(m + 2, program->quadratic, at->c, work->product);
    for (int64_t i = 0; i < m + 2; i++)
        work->change[i] = 0.0;
    solve_bands(n, program, work);
    for (int64_t i = 0; i < m + 2; i++)
        if (!isfinite(work->change[i]))
            return 0;
    return 1;
}

/* The largest step, at most 1, for which no value decreases by more than `share` of itself; worst: of the quotients. */
static double fraction_to_boundary(double worst, double share)
{
    return worst < 0.0 ? least(1.0, -share / worst) : 1.0;
}

/* Move along the change; return the smaller one of the primal and the dual step. */
static double move(Counts n, const Program *program, Settings settings, Iterate *at, Work *work)
{
    double worst = INFINITY, worst_dual = INFINITY, worst_c = INFINITY;
    for (int64_t r = 0; r < n.rows; r++) {
        int64_t size;
        const double *row = row_of(n, program, work, r, &size);
        for (int64_t i = 0; i < n.m; i++) {
            int64_t k = r * n.m + i;
            double change = -(work->value[k] + at->slack[k]) - applied(row, size, i, work->change);
            double dual_change = work->centre[k] - at->dual[k] - work->weight[k] * change;
            work->slack_change[k] = change;
            work->dual_change[k] = dual_change;
            worst = least(worst, change / at->slack[k]);
            worst_dual = least(worst_dual, dual_change / at->dual[k]);
        }
    }
    for (int64_t i = 1; i <= n.m; i++)
        worst_c = least(worst_c, work->change[i] / at->c[i]);
    double step = least(fraction_to_boundary(worst, settings.to_boundary),
                        fraction_to_boundary(worst_c, settings.largest_decrease));
    double dual_step = fraction_to_boundary(worst_dual, settings.to_boundary);
    for (int64_t i = 0; i < n.m + 2; i++)
        at->c[i] += step * work->change[i];
    for (int64_t k = 0; k < n.rows * n.m; k++) {
        at->slack[k] += step * work->slack_change[k];
        at->dual[k] += dual_step * work->dual_change[k];
    }
    return least(step, dual_step);
}

static double objective_of(Counts n, const Program *program, const Work *work)
{
    double objective = 0.0;
    for (int64_t i = 0; i < n.m; i++)
        objective += program->steps[i] / work->root[i];
    return objective;
}

/* Set slack and dual variables of the first iterate; return mu. */
static double begin(Counts n, const Program *program, Settings settings, Iterate *at, const Work *work)
{
    double mu = settings.first_gap * objective_of(n, program, work) / (double)(n.rows * n.m);
    for (int64_t k = 0; k < n.rows * n.m; k++) {
        at->slack[k] = most(-work->value[k], settings.smallest_slack);
        at->dual[k] = mu / at->slack[k];
    }
    return mu;
}

/* Duality gap; residual: out. */
static double gap_of(Counts n, const Iterate *at, const Work *work, double *residual)
{
    double gap = 0.0;
    *residual = 0.0;
    for (int64_t k = 0; k < n.rows * n.m; k++) {
        gap += at->slack[k] * at->dual[k];
        *residual = most(*residual, fabs(work->value[k] + at->slack[k]));
    }
    return gap;
}

static Work work_in(Counts n, double *room)
{
    int64_t all = n.rows * n.m, curved = n.curved * n.m, m = n.m;
    double *stencil = room + 5 * all, *root = stencil + 3 * curved, *normal = root + 2 * m;
    double *change = normal + 9 * m, *factors = change + 2 * (m + 2);
    return (Work){room,   room + all, room + 2 * all, room + 3 * all, room + 4 * all, stencil, root, root + m,
                  normal, normal + 6 * m, change,     change + m + 2, factors};
}

/* Make at most `iterations` iterations of a program with m >= 4 cells.
 *
 *   sizes      m, rows of A, rows of B, number of earlier iterations, iterations
 *   numbers    see `Settings`
 *   program    steps (m,), A (3, linear, m), B (3, curved, m), places (3, curved - 2, m), right shares (m + 1,), bands
 *              of Q (4, m + 2), one after the other
 *   state      in and out: c (m + 2,), slack and dual (linear + curved, m), share (curved, m), mu, and whether the
 *              method has ended
 *   room       work, 5 (linear + curved) m + 3 curved m + 17 m + 4
 *
 * Return the number of iterations, or -1 if a size is too small. */
int64_t optdock_interior_point(int64_t m, int64_t linear, int64_t curved, int64_t before, int64_t iterations,
                               double least_share, double gap, double residual, double to_boundary,
                               double largest_decrease, double long_step, double long_share, double middle_step,
                               double middle_share, double short_share, double smallest_slack, double first_gap,
                               const double *program, double *state, double *room)
{
    if (m < 4 || linear < 0 || curved < 2)
        return -1;
    Counts n = {m, linear, curved, linear + curved};
    Settings settings = {least_share, gap,         residual,     to_boundary, largest_decrease, long_step,
                         long_share,  middle_step, middle_share, short_share, smallest_slack,   first_gap};
    const double *rows = program + m, *places = rows + 3 * n.rows * m, *right = places + 3 * (curved - 2) * m;
    Program given = {program, rows, rows + 3 * linear * m, places, right, right + m + 1};
    double *slack = state + m + 2, *share = slack + 2 * n.rows * m, *mu = share + curved * m, *ended = mu + 1;
    Iterate at = {state, slack, slack + n.rows * m, share};
    Work work = work_in(n, room);
    int64_t done = 0;

    if (before == 0)
        set_shares(n, &given, settings, at.c, at.share);
    evaluate(n, &given, &at, &work);
    if (before == 0)
        *mu = begin(n, &given, settings, &at, &work);
    while (done < iterations && *ended == 0.0) {
        done++;
        if (!newton_change(n, &given, &at, *mu, &work)) {
            *ended = 1.0;
            break;
        }
        double step = move(n, &given, settings, &at, &work);
        if (before + done <= UPDATES)
            set_shares(n, &given, settings, at.c, at.share);
        evaluate(n, &given, &at, &work);
        double violation, distance = gap_of(n, &at, &work, &violation);
        if (distance < settings.gap * objective_of(n, &given, &work) && violation < settings.residual) {
            *ended = 1.0;
            break;
        }
        double next = step > settings.long_step     ? settings.long_share
                      : step > settings.middle_step ? settings.middle_share
                                                    : settings.short_share;
        *mu = next * distance / (double)(n.rows * m);
    }
    return done;
}
