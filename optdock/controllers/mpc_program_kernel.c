/* Data of the MPC's program: the functions `condensed` and `cost_to_go` of `mpc_program.py` in C.
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

/* Condense the errors over the horizon.
 *
 *   n            number of steps
 *   lag          lag of the drive [s]
 *   poses        (2 n + 2, 3), at the borders of the steps, and then poses later by the lag
 *   h            (n,), length of the steps [s]
 *   start        (5,), the state
 *   weights      (3,), of the errors per second
 *   cost_to_go   (3, 3)
 *   out          out: nominal, (n, 2); errors, (n, 3); by_commands, (n, 3, 2 n); hessian, (2 n, 2 n); gradient, (2 n,);
 *                and work, (5, 2 n)
 *
 * Return n. */
int64_t optdock_condense(int64_t n, double lag, const double *poses, const double *h, const double *start,
                         const double *weights, const double *cost_to_go, double *out)
{
    int64_t columns = 2 * n;
    double *errors = out + 2 * n, *by = errors + 3 * n, *hessian = by + 6 * n * n, *gradient = hessian + 4 * n * n;
    double *effect = gradient + 2 * n, state[5];
    for (int64_t i = 2 * n; i < 17 * n + 10 * n * n; i++)
        out[i] = 0.0;
    for (int i = 0; i < 5; i++)
        state[i] = start[i];
    for (int64_t k = 0; k < n; k++) {
        Arc leading = arc_between(poses + 3 * (n + 1 + k), poses + 3 * (n + 2 + k), h[k]);
        Step step = step_of(arc_between(poses + 3 * k, poses + 3 * (k + 1), h[k]), lag);
        double weight[3][3] = {{0.0}}, *by_step = by + 3 * columns * k;
        out[2 * k] = leading.v;
        out[2 * k + 1] = leading.w;
        advance(&step, k, columns, state, effect);
        for (int i = 0; i < 3; i++) {
            errors[3 * k + i] = state[i];
            for (int64_t p = 0; p < 2 * k + 2; p++)
                by_step[i * columns + p] = effect[i * columns + p];
            for (int j = 0; j < 3; j++)
                weight[i][j] = (i == j ? h[k] * weights[i] : 0.0) + (k == n - 1 ? cost_to_go[3 * i + j] : 0.0);
        }
        add_cost((const double (*)[3])weight, state, by_step, 2 * k + 2, columns, hessian, gradient);
    }
    for (int64_t p = 0; p < columns; p++)
        for (int64_t q = 0; q < p; q++)
            hessian[p * columns + q] = hessian[q * columns + p];
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
