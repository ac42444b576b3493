/* Program of the MPC: the functions `filled` and `cost_to_go` of `mpc_program.py` in C.
 *
 * The cost is (K9) and the dynamics of a step (K10) of docs/theory/controller.md. Sines and cosines are those of the C
 * library, and sums are in another order, so the results are equal to those of the twins up to rounding. */

#include <math.h>
#include <stdint.h>

static const double PI = 3.14159265358979323846;

/* Mean motion of the reference over a step, and the offset of the reference from the end of the arc, see
 * `ReferenceArcs`. */
typedef struct {
    double v, w, h, turn, residual[2];
} Arc;

static double chord_share(double half) { return half == 0.0 ? 1.0 : sin(half) / half; }

/* The arc between two poses (3,). */
static Arc arc_between(const double *from, const double *to, double h)
{
    double turn = to[2] - from[2];
    turn -= 2.0 * PI * nearbyint(turn / (2.0 * PI));
    double half = 0.5 * turn, c = cos(from[2] + half), s = sin(from[2] + half);
    double dx = to[0] - from[0], dy = to[1] - from[1], aside = c * dy - s * dx;
    return (Arc){(c * dx + s * dy) / (h * chord_share(half)), turn / h, h, turn, {sin(half) * aside, cos(half) * aside}};
}

/* z' = A z + B u + c. */
typedef struct {
    double a[5][5], b[5][2], c[5];
} Step;

static Step step_of(Arc arc, double lag)
{
    Step step = {{{0.0}}, {{0.0}}, {0.0}};
    double h = arc.h, half = 0.5 * arc.turn, c = cos(half), s = sin(half), chord = h * chord_share(half);
    double cw = cos(arc.turn), sw = sin(arc.turn);
    double by_yaw[2] = {arc.v * chord * s, arc.v * chord * c}, by_speed[2] = {chord * c, -chord * s};
    double by_rate[2] = {0.5 * h * by_yaw[0], 0.5 * h * by_yaw[1]};
    double decay = lag > 0.0 ? exp(-h / lag) : 0.0, kept = (1.0 - decay) * lag / h;
    double rotation[2][2] = {{cw, sw}, {-sw, cw}};
    for (int i = 0; i < 2; i++) {
        step.a[i][0] = rotation[i][0];
        step.a[i][1] = rotation[i][1];
        step.a[i][2] = by_yaw[i];
        step.a[i][3] = kept * by_speed[i];
        step.a[i][4] = kept * by_rate[i];
        step.b[i][0] = (1.0 - kept) * by_speed[i];
        step.b[i][1] = (1.0 - kept) * by_rate[i];
        step.c[i] = -by_speed[i] * arc.v - by_rate[i] * arc.w - arc.residual[i];
        step.a[3 + i][3 + i] = decay;
        step.b[3 + i][i] = 1.0 - decay;
    }
    step.a[2][2] = 1.0;
    step.a[2][4] = kept * h;
    step.b[2][1] = (1.0 - kept) * h;
    step.c[2] = -arc.turn;
    return step;
}

/* Advance the state (5,) and its derivatives with respect to the commands, (5, columns), of which the first 2 k are not
 * zero, by step k. */
static void advance(const Step *step, int64_t k, int64_t columns, double *state, double *effect)
{
    double next[5];
    for (int i = 0; i < 5; i++) {
        next[i] = step->c[i];
        for (int j = 0; j < 5; j++)
            next[i] += step->a[i][j] * state[j];
    }
    for (int i = 0; i < 5; i++)
        state[i] = next[i];
    for (int64_t column = 0; column < 2 * k; column++) {
        for (int i = 0; i < 5; i++) {
            next[i] = 0.0;
            for (int j = 0; j < 5; j++)
                next[i] += step->a[i][j] * effect[j * columns + column];
        }
        for (int i = 0; i < 5; i++)
            effect[i * columns + column] = next[i];
    }
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 2; j++)
            effect[i * columns + 2 * k + j] = step->b[i][j];
}

/* Add the cost of the errors (3,) with the weights (3, 3) to the gradient and to the upper half of the hessian, where
 * `by`, (3, columns), are the derivatives of the errors, of which the first `used` are not zero. */
static void add_cost(const double weights[3][3], const double *errors, const double *by, int64_t used, int64_t columns,
                     double *hessian, double *gradient)
{
    for (int64_t p = 0; p < used; p++) {
        double heavy[3];
        for (int i = 0; i < 3; i++)
            heavy[i] = weights[0][i] * by[p] + weights[1][i] * by[columns + p] + weights[2][i] * by[2 * columns + p];
        gradient[p] += heavy[0] * errors[0] + heavy[1] * errors[1] + heavy[2] * errors[2];
        for (int64_t q = p; q < used; q++)
            hessian[p * columns + q] +=
                heavy[0] * by[q] + heavy[1] * by[columns + q] + heavy[2] * by[2 * columns + q];
    }
}

/* Errors over the horizon of n steps as a function of the commands, see `CondensedErrors`. */
typedef struct {
    double *nominal;           /* (n, 2) */
    double *errors, *by;       /* (n, 3), (n, 3, 2 n) */
    double *hessian, *gradient; /* (2 n, 2 n), of which the upper half is written; (2 n,) */
    double *effect;            /* (5, 2 n) */
} Condensed;

/* Condense the errors, from the reference `poses`, (2 n + 2, 3), the lengths h of the first and of the other steps, the
 * lag of the drive, the state (5,), the weights (3,) of the errors per second and the cost to go (3, 3). */
static void condense(int64_t n, const double *poses, const double *lengths, double lag, const double *start,
                     const double *weights, const double *cost_to_go, const Condensed *out)
{
    int64_t columns = 2 * n;
    double state[5];
    for (int64_t i = 0; i < 17 * n + 10 * n * n; i++)
        out->nominal[i] = 0.0;
    for (int i = 0; i < 5; i++)
        state[i] = start[i];
    for (int64_t k = 0; k < n; k++) {
        double h = lengths[k > 0], weight[3][3] = {{0.0}}, *by = out->by + 3 * columns * k;
        Arc leading = arc_between(poses + 3 * (n + 1 + k), poses + 3 * (n + 2 + k), h);
        Step step = step_of(arc_between(poses + 3 * k, poses + 3 * (k + 1), h), lag);
        out->nominal[2 * k] = leading.v;
        out->nominal[2 * k + 1] = leading.w;
        advance(&step, k, columns, state, out->effect);
        for (int i = 0; i < 3; i++) {
            out->errors[3 * k + i] = state[i];
            for (int64_t p = 0; p < 2 * k + 2; p++)
                by[i * columns + p] = out->effect[i * columns + p];
            for (int j = 0; j < 3; j++)
                weight[i][j] = (i == j ? h * weights[i] : 0.0) + (k == n - 1 ? cost_to_go[3 * i + j] : 0.0);
        }
        add_cost((const double (*)[3])weight, state, by, 2 * k + 2, columns, out->hessian, out->gradient);
    }
}

/* Arrays of the program with `variables` variables and m rows. */
typedef struct {
    int64_t variables;
    double *hessian, *gradient; /* (variables, variables), (variables,) */
    double *a;                  /* (m, variables) */
    double *lower, *upper;      /* (variables + m,), of the variables first */
    double unbounded;
} Program;

static double limited(double value, double most)
{
    return value > most ? most : value < -most ? -most : value; /* keeps NaN */
}

/* Set the bounds of a variable, or of a row of number `i` - variables. */
static void set_bounds(const Program *p, int64_t i, double lower, double upper)
{
    p->lower[i] = limited(lower, p->unbounded);
    p->upper[i] = limited(upper, p->unbounded);
}

/* Set the cost: that of the errors and that of the effort (2 n, 2 n), where `first` is the derivative of the cost with
 * respect to the first command by the deviation of the last command. */
static void set_cost(const Program *p, int64_t n, const Condensed *found, const double *effort, const double *first)
{
    for (int64_t i = 0; i < 2 * n; i++) {
        double sum = 0.0;
        for (int64_t j = 0; j < 2 * n; j++) {
            double error = i <= j ? found->hessian[2 * n * i + j] : found->hessian[2 * n * j + i];
            p->hessian[p->variables * i + j] = error + effort[2 * n * i + j];
            sum += effort[2 * n * i + j] * found->nominal[j];
        }
        p->gradient[i] = found->gradient[i] - sum - (i < 2 ? first[i] : 0.0);
    }
}

/* The limits of the robot in `fixed`, and the bounds of the next command in `next`. */
enum { REVERSE, FORWARD, RISE, FALL, YAW_ACCELERATION, JERK, LATERAL, CROSS, YAW, LIMITS };
enum { LEAST_SPEED, MOST_SPEED, LEAST_CHANGE, MOST_CHANGE, NEXT_LATERAL, NEXT };

/* Set the bounds of speeds and accelerations, and the rows and bounds of the lateral accelerations, from the row
 * `lateral` on, linearized about the last command and the nominal ones. */
static void bound_speeds(const Program *p, int64_t n, int64_t lateral, const double *nominal, const double *limits,
                         const double *next, const double *last, double span)
{
    double least = limits[RISE] < limits[FALL] ? limits[RISE] : limits[FALL];
    for (int64_t k = 0; k < n; k++) {
        double travel = nominal[2 * k] + nominal[2 * (k > 0 ? k - 1 : 0)];
        double up = travel > 0.0 ? limits[RISE] : travel < 0.0 ? limits[FALL] : least;
        double down = travel > 0.0 ? limits[FALL] : travel < 0.0 ? limits[RISE] : least;
        double v = k > 0 ? nominal[2 * k] : last[0], w = k > 0 ? nominal[2 * k + 1] : last[1];
        double sideways = k > 0 ? limits[LATERAL] : next[NEXT_LATERAL], *row = p->a + (lateral + k) * p->variables;
        if (k > 0) {
            set_bounds(p, 2 * k, -limits[REVERSE], limits[FORWARD]);
            set_bounds(p, p->variables + k, -down, up);
        }
        row[2 * k] = w;
        row[2 * k + 1] = v;
        set_bounds(p, p->variables + lateral + k, -sideways + v * w, sideways + v * w);
    }
    set_bounds(p, 0, next[LEAST_SPEED], next[MOST_SPEED]);
    set_bounds(p, p->variables, next[LEAST_CHANGE] + last[0] / span, next[MOST_CHANGE] + last[0] / span);
    set_bounds(p, p->variables + n, last[1] / span - limits[YAW_ACCELERATION],
               last[1] / span + limits[YAW_ACCELERATION]);
}

/* Set the rows of the tube from the row `tube` on: cross and yaw errors after every step in both directions. */
static void bound_errors(const Program *p, int64_t n, int64_t tube, const Condensed *found, const double *widths)
{
    for (int64_t i = 0; i < 2; i++)
        for (int64_t k = 0; k < n; k++) {
            int64_t upper = tube + 2 * n * i + k, lower = upper + n;
            const double *by = found->by + 2 * n * (3 * k + 1 + i);
            double error = found->errors[3 * k + 1 + i];
            for (int64_t j = 0; j < 2 * k + 2; j++) {
                p->a[upper * p->variables + j] = by[j];
                p->a[lower * p->variables + j] = -by[j];
            }
            p->upper[p->variables + upper] = limited(widths[i] - error, p->unbounded);
            p->upper[p->variables + lower] = limited(widths[i] + error, p->unbounded);
        }
}

/* Fill the part of the program that changes in every cycle.
 *
 *   n, rows, tube      numbers of steps and of rows; first row of the tube, or `rows` without a tube
 *   unbounded          value for infinity
 *   lag                lag of the drive [s]
 *   poses              (2 n + 2, 3), reference at the borders of the steps, and then poses later by the lag
 *   cost_to_go         (3, 3)
 *   cycle              (17,): length of the first and of the other steps; the state; the last command, its acceleration
 *                      and its nominal command; the bounds of the next command
 *   fixed              (14 + 2 n + 4 n^2,): weights of the errors and of changes; limits; spans of accelerations and
 *                      of jerks; cost of the effort
 *   hessian, gradient  out, (variables, variables), (variables,), where variables = 2 n + 2
 *   a, bounds          out, (rows, variables), (2, variables + rows)
 *   work               out: nominal, (n, 2); and (15 n + 10 n^2,)
 *
 * Return n. */
int64_t optdock_fill_tracking_program(int64_t n, int64_t rows, int64_t tube, double unbounded, double lag,
                                      const double *poses, const double *cost_to_go, const double *cycle,
                                      const double *fixed, double *hessian, double *gradient, double *a, double *bounds,
                                      double *work)
{
    int64_t variables = 2 * n + 2, up = variables + 2 * n, down = up + n;
    Program p = {variables, hessian, gradient, a, bounds, bounds + variables + rows, unbounded};
    Condensed found = {.nominal = work, .errors = work + 2 * n, .by = work + 5 * n};
    found.hessian = found.by + 6 * n * n;
    found.gradient = found.hessian + 4 * n * n;
    found.effect = found.gradient + 2 * n;
    const double *state = cycle + 2, *last = cycle + 7, *before = cycle + 10, *next = cycle + 12;
    const double *change = fixed + 3, *limits = fixed + 5, *spans = limits + LIMITS, *jerk_spans = spans + n;
    condense(n, poses, cycle, lag, state, fixed, cost_to_go, &found);
    double first[2];
    for (int i = 0; i < 2; i++)
        first[i] = change[i] / spans[0] * (last[i] - before[i]);
    set_cost(&p, n, &found, jerk_spans + n, first);
    bound_speeds(&p, n, 6 * n, found.nominal, limits, next, last, spans[0]);
    /* jerk = (second differences of u) with the last command and its acceleration before the first */
    double known[2] = {-(last[0] / spans[0] + last[2]) / jerk_spans[0], last[0] / spans[0] / jerk_spans[1]};
    for (int k = 0; k < 2; k++) {
        p.upper[up + k] = limited(limits[JERK] - known[k], unbounded);
        p.upper[down + k] = limited(limits[JERK] + known[k], unbounded);
    }
    if (tube < rows)
        bound_errors(&p, n, tube, &found, limits + CROSS);
    return n;
}

/* One step back: the cost matrix p after a step becomes that before it. */
static void riccati_step(const Step *step, double h, const double *weights, double p[3][3])
{
    double pa[3][3], pb[3][2], m[2][2], bpa[2][3], gain[2][3], next[3][3];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            pa[i][j] = p[i][0] * step->a[0][j] + p[i][1] * step->a[1][j] + p[i][2] * step->a[2][j];
        for (int j = 0; j < 2; j++)
            pb[i][j] = p[i][0] * step->b[0][j] + p[i][1] * step->b[1][j] + p[i][2] * step->b[2][j];
    }
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++)
            m[i][j] = step->b[0][i] * pb[0][j] + step->b[1][i] * pb[1][j] + step->b[2][i] * pb[2][j] +
                      (i == j ? h * weights[3 + i] : 0.0);
        for (int j = 0; j < 3; j++)
            bpa[i][j] = pb[0][i] * step->a[0][j] + pb[1][i] * step->a[1][j] + pb[2][i] * step->a[2][j];
    }
    double determinant = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    for (int j = 0; j < 3; j++) {
        gain[0][j] = (m[1][1] * bpa[0][j] - m[0][1] * bpa[1][j]) / determinant;
        gain[1][j] = (m[0][0] * bpa[1][j] - m[1][0] * bpa[0][j]) / determinant;
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            next[i][j] = step->a[0][i] * pa[0][j] + step->a[1][i] * pa[1][j] + step->a[2][i] * pa[2][j] -
                         bpa[0][i] * gain[0][j] - bpa[1][i] * gain[1][j] + (i == j ? h * weights[i] : 0.0);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            p[i][j] = 0.5 * (next[i][j] + next[j][i]);
}

/* Riccati recursion from the end of a reference to its start.
 *
 *   n         number of steps
 *   poses     (n + 1, 3)
 *   times     (n + 1,) [s]
 *   weights   (8,): errors per second, commands per second, errors at the end
 *   cost      out, (n + 1, 3, 3)
 *
 * Return n. */
int64_t optdock_cost_to_go(int64_t n, const double *poses, const double *times, const double *weights, double *cost)
{
    double p[3][3] = {{0.0}};
    for (int i = 0; i < 3; i++)
        p[i][i] = weights[5 + i];
    for (int64_t k = n; k >= 0; k--) {
        if (k < n) {
            double h = times[k + 1] - times[k];
            Step step = step_of(arc_between(poses + 3 * k, poses + 3 * (k + 1), h), 0.0);
            riccati_step(&step, h, weights, p);
        }
        for (int i = 0; i < 9; i++)
            cost[9 * k + i] = p[i / 3][i % 3];
    }
    return n;
}
