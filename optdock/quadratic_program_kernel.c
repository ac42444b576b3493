/* Minimizer of a convex quadratic program by a dual active-set method: `minimizer` of `quadratic_program.py` in C.
 *
 * With H = L L', x = x0 + L'^-1 u and m_i = L^-1 a_i, the program is to find the u of least norm with m_i u >= d_i. Its
 * dual is to maximize d' p - |M' p|^2 / 2 over p >= 0. Of the working set W, the method keeps the factors L D L' of
 * M_W M_W'. Each round moves the multipliers p towards those of the minimizer on W; a constraint whose multiplier
 * becomes 0 before is removed. Then constraints that the minimizer violates are added [Arnstrom2022], [Goldfarb1983].
 * The dual increases in each round except for rounding errors, see `find`, so the method ends.
 *
 * A constraint is a number, 1 to n for the bounds of a variable and n + 1 to n + m for those of a row; it is negative
 * for the upper bound. The elements of a row other than 0 are in one range among the first `leading` columns, and in
 * one among the others.
 *
 * The twin finds the set by DAQP, so sums may be in any order here. The minimizer is then that of the linear equations
 * of the set, whose sums are in the order of the twin; it is equal to the last bit. */

#include <math.h>
#include <stdint.h>

typedef struct {
    int64_t n, m, leading;
    const double *h, *a, *lower, *upper; /* (n, n); (m, n); bounds (n + m,) */
    double unbounded;
    double *root;   /* (n, n), L in the lower triangle */
    int64_t *range; /* (m, 4) */
    double *scale;  /* (n + m,), 1 over an estimate of |m_i| */
    double *x0;     /* (n,), minimizer without constraints */
} Program;

typedef struct {
    int64_t count, fixed; /* of W; equalities are its first elements */
    int64_t most;         /* n + 1 */
    int64_t *number;      /* (most,), constraints of W with their signs */
    int64_t *taken;       /* (n + m,), whether a constraint is in W */
    double *normals;      /* (most, n), rows m_i */
    double *factor;       /* (most, most), L below its diagonal */
    double *pivot;        /* (most,), D */
    double *wanted;       /* (most,), d_i */
    double *solved;       /* (most,), L^-1 d, valid in the first `valid` rows */
    double *dual, *goal;  /* (most,), multipliers, and those of the minimizer on W */
    double *work;         /* (most,) */
    int64_t valid;
} WorkingSet;

static const double DEPENDENT = 1e-11;  /* of |m|^2: smaller pivots are 0 */
static const double NEARLY = 0.3;       /* of the largest violation */
static const double ROUNDING = 1e-9;    /* violations up to it are accepted where no set has smaller ones */
static const int64_t MOST_STALLED = 20; /* rounds in which the dual does not increase */

static double dot(const double *a, const double *b, int64_t count)
{
    double s0 = 0.0, s1 = 0.0, s2 = 0.0, s3 = 0.0;
    int64_t i = 0;
    for (; i + 4 <= count; i += 4) {
        s0 += a[i] * b[i];
        s1 += a[i + 1] * b[i + 1];
        s2 += a[i + 2] * b[i + 2];
        s3 += a[i + 3] * b[i + 3];
    }
    for (; i < count; i++)
        s0 += a[i] * b[i];
    return (s0 + s1) + (s2 + s3);
}

/* The variable, or n and the row, of a constraint. */
static int64_t place_of(int64_t number) { return (number > 0 ? number : -number) - 1; }

static void add_scaled(double *to, double factor, const double *from, int64_t count)
{
    for (int64_t i = 0; i < count; i++)
        to[i] += factor * from[i];
}

/* x = L'^-1 x. */
static void solve_transposed(const Program *p, double *x)
{
    for (int64_t i = p->n - 1; i >= 0; i--) {
        const double *row = p->root + i * p->n;
        x[i] /= row[i];
        add_scaled(x, -x[i], row, i);
    }
}

/* x = L^-1 x for an x whose first `first` elements are 0. */
static void solve_forward(const Program *p, double *x, int64_t first)
{
    for (int64_t i = first; i < p->n; i++) {
        const double *row = p->root + i * p->n;
        x[i] = (x[i] - dot(row + first, x + first, i - first)) / row[i];
    }
}

static void set_range(const double *row, int64_t first, int64_t end, int64_t *range)
{
    while (first < end && row[first] == 0.0)
        first++;
    while (end > first && row[end - 1] == 0.0)
        end--;
    range[0] = first;
    range[1] = end;
}

static double value_of(const Program *p, int64_t row, const double *x)
{
    const double *a = p->a + row * p->n;
    const int64_t *range = p->range + 4 * row;
    return dot(a + range[0], x + range[0], range[1] - range[0]) + dot(a + range[2], x + range[2], range[3] - range[2]);
}

/* Returns whether H is positive definite. */
static int set_root(const Program *p)
{
    for (int64_t i = 0; i < p->n; i++) {
        double *row = p->root + i * p->n;
        for (int64_t j = 0; j <= i; j++) {
            const double *other = p->root + j * p->n;
            row[j] = p->h[i * p->n + j] - dot(row, other, j);
            if (j < i)
                row[j] /= other[j];
        }
        if (!(row[i] > 0.0))
            return 0;
        row[i] = sqrt(row[i]);
    }
    return 1;
}

static void prepare(const Program *p, const double *g)
{
    double *inverse = p->scale; /* 1 / H_kk, whose roots are the scales of the variables' own bounds */
    for (int64_t i = 0; i < p->n; i++) {
        const double *row = p->root + i * p->n;
        inverse[i] = 1.0 / dot(row, row, i + 1);
        p->x0[i] = -g[i];
    }
    solve_forward(p, p->x0, 0);
    solve_transposed(p, p->x0);
    for (int64_t i = 0; i < p->m; i++) {
        const double *row = p->a + i * p->n;
        int64_t *range = p->range + 4 * i;
        double sum = 0.0;
        set_range(row, 0, p->leading, range);
        set_range(row, p->leading, p->n, range + 2);
        for (int64_t k = range[0]; k < range[1]; k++)
            sum += row[k] * row[k] * inverse[k];
        for (int64_t k = range[2]; k < range[3]; k++)
            sum += row[k] * row[k] * inverse[k];
        p->scale[p->n + i] = sum > 0.0 ? 1.0 / sqrt(sum) : 1.0;
    }
    for (int64_t i = 0; i < p->n; i++)
        p->scale[i] = 1.0 / sqrt(inverse[i]);
}

/* The normal of a constraint and its bound at x0, written behind W; then the last row of the factors. Returns whether
 * the normal is independent of W. */
static int append(const Program *p, WorkingSet *w, int64_t number)
{
    int64_t i = place_of(number), q = w->count, first = i;
    double sign = number > 0 ? 1.0 : -1.0, *normal = w->normals + q * p->n, *row = w->factor + q * w->most;
    for (int64_t k = 0; k < p->n; k++)
        normal[k] = 0.0;
    if (i < p->n) {
        normal[i] = sign;
        w->wanted[q] = sign * ((number > 0 ? p->lower : p->upper)[i] - p->x0[i]);
    } else {
        const int64_t *range = p->range + 4 * (i - p->n);
        const double *a = p->a + (i - p->n) * p->n;
        for (int64_t k = range[0]; k < range[1]; k++)
            normal[k] = sign * a[k];
        for (int64_t k = range[2]; k < range[3]; k++)
            normal[k] = sign * a[k];
        first = range[0] < range[1] ? range[0] : range[2];
        w->wanted[q] = sign * ((number > 0 ? p->lower : p->upper)[i] - value_of(p, i - p->n, p->x0));
    }
    solve_forward(p, normal, first);
    double square = dot(normal + first, normal + first, p->n - first), left = square;
    for (int64_t j = 0; j < q; j++)
        row[j] = dot(w->normals + j * p->n + first, normal + first, p->n - first);
    for (int64_t j = 0; j < q; j++)
        row[j] -= dot(w->factor + j * w->most, row, j);
    for (int64_t j = 0; j < q; j++) {
        double z = row[j];
        row[j] = z / w->pivot[j];
        left -= z * row[j];
    }
    w->number[q] = number;
    w->pivot[q] = left;
    w->dual[q] = 0.0;
    return left > DEPENDENT * square && q < p->n;
}

static void keep_appended(WorkingSet *w)
{
    int64_t number = w->number[w->count];
    w->taken[place_of(number)] = 1;
    w->count++;
}

/* Removes element r of W; the factors behind it are updated by a product of rank one [Gill1974]. */
static void remove_from(const Program *p, WorkingSet *w, int64_t r)
{
    int64_t number = w->number[r], last = w->count - 1;
    double *column = w->work, added = w->pivot[r];
    w->taken[place_of(number)] = 0;
    for (int64_t i = r; i < last; i++) {
        column[i] = w->factor[(i + 1) * w->most + r];
        w->number[i] = w->number[i + 1];
        w->wanted[i] = w->wanted[i + 1];
        w->dual[i] = w->dual[i + 1];
        w->pivot[i] = w->pivot[i + 1];
        for (int64_t k = 0; k < p->n; k++)
            w->normals[i * p->n + k] = w->normals[(i + 1) * p->n + k];
        double *row = w->factor + i * w->most;
        const double *next = row + w->most;
        for (int64_t k = 0; k < r; k++)
            row[k] = next[k];
        for (int64_t k = r; k < i; k++)
            row[k] = next[k + 1];
    }
    for (int64_t j = r; j < last; j++) {
        double z = column[j], pivot = w->pivot[j] + added * z * z, beta = added * z / pivot;
        added *= w->pivot[j] / pivot;
        w->pivot[j] = pivot;
        for (int64_t i = j + 1; i < last; i++) {
            double *element = w->factor + i * w->most + j;
            column[i] -= z * *element;
            *element += beta * column[i];
        }
    }
    w->count = last;
    w->valid = r < w->valid ? r : w->valid;
}

/* Multipliers of the minimizer on W. */
static void set_goal(WorkingSet *w)
{
    for (int64_t i = w->valid; i < w->count; i++)
        w->solved[i] = w->wanted[i] - dot(w->factor + i * w->most, w->solved, i);
    w->valid = w->count;
    for (int64_t i = 0; i < w->count; i++)
        w->goal[i] = w->solved[i] / w->pivot[i];
    for (int64_t i = w->count - 1; i > 0; i--)
        add_scaled(w->goal, -w->goal[i], w->factor + i * w->most, i);
}

/* Moves the multipliers to those of the minimizer on W, and removes the constraints whose multiplier becomes negative.
 * Returns the number of removed constraints. */
static int64_t reach_goal(const Program *p, WorkingSet *w)
{
    for (int64_t removed = 0;; removed++) {
        int64_t blocking = -1;
        double step = 1.0, lowest = 0.0;
        set_goal(w);
        for (int64_t i = w->fixed; i < w->count; i++) {
            if (!(w->goal[i] < 0.0))
                continue;
            double share = w->dual[i] / (w->dual[i] - w->goal[i]);
            if (share < step || (share == step && w->goal[i] < lowest)) {
                step = share;
                lowest = w->goal[i];
                blocking = i;
            }
        }
        for (int64_t i = 0; i < w->count; i++)
            w->dual[i] += step * (w->goal[i] - w->dual[i]);
        if (blocking < 0)
            return removed;
        remove_from(p, w, blocking);
    }
}

/* For an appended constraint whose normal depends on W: moves the multipliers while u is kept, and removes the
 * constraint whose multiplier becomes 0 first. Returns whether there is one and the appended constraint is independent of
 * the others; else W keeps its constraints. */
static int exchange(const Program *p, WorkingSet *w, int64_t number)
{
    double *change = w->goal, *row = w->factor + w->count * w->most, step = INFINITY;
    int64_t blocking = -1;
    for (int64_t i = 0; i < w->count; i++)
        change[i] = -row[i];
    for (int64_t i = w->count - 1; i > 0; i--)
        add_scaled(change, -change[i], w->factor + i * w->most, i);
    for (int64_t i = w->fixed; i < w->count; i++) {
        if (change[i] < -1e-12 && w->dual[i] < -change[i] * step) {
            step = w->dual[i] / -change[i];
            blocking = i;
        }
    }
    if (blocking < 0)
        return 0;
    for (int64_t i = 0; i < w->count; i++)
        w->dual[i] += step * change[i];
    int64_t removed = w->number[blocking];
    remove_from(p, w, blocking);
    if (append(p, w, number)) {
        w->dual[w->count] = step;
        return 1;
    }
    if (append(p, w, removed))
        keep_appended(w);
    return 0;
}

/* Violations by x relative to their scales, negative for upper bounds; 0 in W. Returns the index of the largest one. */
static int64_t measure(const Program *p, const WorkingSet *w, const double *x, double *violation)
{
    int64_t worst = 0;
    for (int64_t i = 0; i < p->n + p->m; i++) {
        double value = w->taken[i] ? p->lower[i] : i < p->n ? x[i] : value_of(p, i - p->n, x);
        double below = (p->lower[i] - value) * p->scale[i], above = (value - p->upper[i]) * p->scale[i];
        violation[i] = w->taken[i] ? 0.0 : below > 0.0 ? below : above > 0.0 ? -above : 0.0;
        if (fabs(violation[i]) > fabs(violation[worst]))
            worst = i;
    }
    return worst;
}

static int64_t numbered(int64_t i, double violation) { return violation > 0.0 ? i + 1 : -(i + 1); }

/* Adds the constraint that is violated most, and those that are violated nearly as much and more than their neighbours.
 * Returns whether the program may be feasible. */
static int add_violated(const Program *p, WorkingSet *w, const double *violation, int64_t worst)
{
    int64_t number = numbered(worst, violation[worst]), last = p->n + p->m - 1;
    double least = NEARLY * fabs(violation[worst]);
    if (!append(p, w, number) && !exchange(p, w, number))
        return 0;
    keep_appended(w);
    for (int64_t i = 0; i <= last; i++) {
        double here = fabs(violation[i]);
        if (here < least || w->taken[i] || (i > 0 && here < fabs(violation[i - 1])) ||
            (i < last && here <= fabs(violation[i + 1])))
            continue;
        if (append(p, w, numbered(i, violation[i])))
            keep_appended(w);
    }
    return 1;
}

/* The equalities, and the independent constraints of the guess; other numbers are skipped. */
static void begin(const Program *p, WorkingSet *w, const int64_t *guess, int64_t guessed)
{
    for (int64_t i = 0; i < p->n + p->m; i++)
        w->taken[i] = 0;
    for (int64_t i = 0; i < p->n + p->m; i++)
        if (p->lower[i] == p->upper[i] && append(p, w, i + 1))
            keep_appended(w);
    w->fixed = w->count;
    for (int64_t i = 0; i < guessed; i++) {
        int64_t k = place_of(guess[i]);
        if (k < 0 || k >= p->n + p->m)
            continue;
        double bound = (guess[i] > 0 ? p->lower : p->upper)[k];
        if (!w->taken[k] && fabs(bound) < p->unbounded && append(p, w, guess[i]))
            keep_appended(w);
    }
}

/* Linear equations for the free variables and the multipliers of the rows of a set. */
typedef struct {
    int64_t fixed, free, size; /* numbers of the fixed and the free variables, and of the equations */
    int64_t *member, *index;   /* (n,), variables and rows of the set in order; (n,), free variables */
    double *bound;             /* (n,), of the set */
    double *matrix, *factor;   /* (size, size); (size, size), L of which the lower triangle is used */
    double *pivot, *column, *right, *solved, *left; /* (size,) */
} Equations;

/* Splits the variables, and sets the matrix and the right sides. */
static void set_equations(const Program *p, const WorkingSet *w, const double *g, Equations *e)
{
    int64_t members = 0;
    for (int64_t k = 0; k < p->n + p->m; k++) {
        if (w->taken[k])
            e->member[members++] = k;
        else if (k < p->n)
            e->index[e->free++] = k;
    }
    e->fixed = p->n - e->free;
    e->size = e->free + members - e->fixed;
    for (int64_t i = 0; i < w->count; i++) {
        int64_t k = place_of(w->number[i]), at = 0;
        while (e->member[at] != k)
            at++;
        e->bound[at] = (w->number[i] > 0 ? p->lower : p->upper)[k];
    }
    for (int64_t i = 0; i < e->size; i++) {
        int64_t is_row = i >= e->free, at = e->fixed + i - e->free;
        const double *row = is_row ? p->a + (e->member[at] - p->n) * p->n : p->h + e->index[i] * p->n;
        double sum = 0.0;
        for (int64_t c = 0; c < e->fixed; c++)
            sum += row[e->member[c]] * e->bound[c];
        e->right[i] = (is_row ? e->bound[at] : -g[e->index[i]]) - sum;
        for (int64_t k = 0; k < e->free; k++) {
            e->matrix[i * e->size + k] = row[e->index[k]];
            if (is_row)
                e->matrix[k * e->size + i] = row[e->index[k]];
        }
        for (int64_t k = e->free; is_row && k < e->size; k++)
            e->matrix[i * e->size + k] = 0.0;
    }
}

/* Factors L D L'. Pivoting is not needed: the first block is positive definite, and the rows are independent. */
static void factorize(Equations *e)
{
    int64_t size = e->size;
    for (int64_t i = 0; i < size; i++)
        for (int64_t j = 0; j <= i; j++)
            e->factor[i * size + j] = e->matrix[i * size + j];
    for (int64_t j = 0; j < size; j++) {
        e->pivot[j] = e->factor[j * size + j];
        for (int64_t i = j + 1; i < size; i++)
            e->column[i] = e->factor[i * size + j];
        for (int64_t i = j + 1; i < size; i++) {
            double *row = e->factor + i * size;
            row[j] /= e->pivot[j];
            add_scaled(row + j + 1, -row[j], e->column + j + 1, i - j);
        }
    }
}

static void solve_factorized(const Equations *e, double *x)
{
    for (int64_t i = 1; i < e->size; i++)
        for (int64_t j = 0; j < i; j++)
            x[i] -= e->factor[i * e->size + j] * x[j];
    for (int64_t i = 0; i < e->size; i++)
        x[i] /= e->pivot[i];
    for (int64_t i = e->size - 1; i > 0; i--)
        add_scaled(x, -x[i], e->factor + i * e->size, i);
}

/* Solves the equations, with one refinement. */
static void solve_equations(Equations *e, double *solution)
{
    factorize(e);
    for (int64_t i = 0; i < e->size; i++) {
        e->solved[i] = e->right[i];
        e->left[i] = 0.0;
    }
    solve_factorized(e, e->solved);
    for (int64_t i = 0; i < e->size; i++)
        add_scaled(e->left, e->solved[i], e->matrix + i * e->size, e->size);
    for (int64_t i = 0; i < e->size; i++)
        e->left[i] = e->right[i] - e->left[i];
    solve_factorized(e, e->left);
    for (int64_t i = 0; i < e->fixed; i++)
        solution[e->member[i]] = e->bound[i];
    for (int64_t i = 0; i < e->free; i++)
        solution[e->index[i]] = e->solved[i] + e->left[i];
}

/* Writes the constraints that the solution attains in order, and returns their number. */
static int64_t set_attained(const Program *p, const double *x, double tolerance, int64_t *found)
{
    int64_t count = 0;
    for (int64_t i = 0; i < p->n + p->m; i++) {
        double value = i < p->n ? x[i] : value_of(p, i - p->n, x);
        if (value - p->lower[i] < tolerance)
            found[count++] = i + 1;
        else if (p->upper[i] - value < tolerance)
            found[count++] = -(i + 1);
    }
    return count;
}

/* The active set is in W. Returns whether it is found in so many rounds.
 *
 * The dual at the minimizer on W is |u|^2 / 2. Of constraints that depend on each other, rounding errors may leave one
 * violated whichever others are in W: then the dual does not increase any more, or the constraint cannot be added. */
static int find(const Program *p, WorkingSet *w, int64_t rounds, double tolerance, double *x, double *violation)
{
    double best = -1.0;
    for (int64_t done = 0, stalled = 0; done < rounds; done++, stalled++) {
        done += reach_goal(p, w);
        for (int64_t k = 0; k < p->n; k++)
            x[k] = 0.0;
        for (int64_t i = 0; i < w->count; i++)
            add_scaled(x, w->dual[i], w->normals + i * p->n, p->n);
        double dual = dot(x, x, p->n);
        solve_transposed(p, x);
        add_scaled(x, 1.0, p->x0, p->n);
        int64_t worst = measure(p, w, x, violation);
        if (!(fabs(violation[worst]) > tolerance))
            return 1;
        if (dual > best) {
            best = dual;
            stalled = 0;
        }
        int64_t count = w->count;
        if (stalled >= MOST_STALLED || !add_violated(p, w, violation, worst))
            return w->count == count && fabs(violation[worst]) <= ROUNDING;
    }
    return 0;
}

/* Writes the minimizer and the constraints that it attains, and returns their number; -1 if no active set is found.
 *
 * h: (n, n); g: (n,); a: (m, n); bounds: (2, n + m), the lower and the upper ones. guess: (guessed,), constraints that
 * are probably active. ints: (5 n + 6 m + 1,), the attained constraints first. doubles:
 * ((n + 1) (2 n + 7) + 16 n + 2 m + 9 n^2,), the minimizer first. */
int64_t optdock_minimizer(int64_t n, int64_t m, int64_t leading, int64_t guessed, int64_t rounds, double unbounded,
                          double tolerance, double attained, const double *h, const double *g, const double *a,
                          const double *bounds, const int64_t *guess, int64_t *ints, double *doubles)
{
    int64_t most = n + 1, *found = ints, *range = found + n + m, *members = range + n + 5 * m;
    double *solution = doubles, *root = solution + n, *scale = root + n * n;
    Program p = {n, m, leading, h, a, bounds, bounds + n + m, unbounded, root, range, scale, scale + n + m};
    WorkingSet w = {.most = most, .number = members, .taken = range + 4 * m};
    double *violation = p.x0 + n, *next = violation + n + m;
    double **parts[] = {&w.pivot, &w.wanted, &w.solved, &w.dual, &w.goal, &w.work};
    for (int64_t i = 0; i < 6; i++, next += most)
        *parts[i] = next;
    w.normals = next;
    w.factor = next + most * n;
    if (!set_root(&p))
        return -1;
    prepare(&p, g);
    begin(&p, &w, guess, guessed);
    if (!find(&p, &w, rounds, tolerance, solution, violation))
        return -1;
    next = w.factor + most * most;
    Equations e = {.member = members + most, .index = members + most + n, .bound = next};
    next += n;
    double **columns[] = {&e.pivot, &e.column, &e.right, &e.solved, &e.left};
    for (int64_t i = 0; i < 5; i++, next += 2 * n)
        *columns[i] = next;
    e.matrix = next;
    e.factor = next + 4 * n * n;
    set_equations(&p, &w, g, &e);
    solve_equations(&e, solution);
    return set_attained(&p, solution, attained, found);
}
