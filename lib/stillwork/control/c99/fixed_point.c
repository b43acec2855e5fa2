#include "$name.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#ifdef __FAST_MATH__
#error "missing numbers need IEEE arithmetic: compile without -ffast-math"
#endif

typedef ${name}_real real;

#define N ${guard}_COORDINATES
#define GAINS ${guard}_GAINS
#define INTEGRALS (GAINS - 2)
w|#define WINDOW $window
e|#define STATES $states
u|#define POINTS 5

static const real dt = $step;
u|static const real variance[N] = $variance; /* of both states at first */
e|static const real variances[N][3] = $variances; /* of position, velocity and disturbance at first */

const ${name}_tuning ${name}_designed = {
$designed};

static bool is_number(real value)
{
    return isfinite(value) != 0;
}

static real magnitude(real value)
{
    return value < $zero ? -value : value;
}

w|/* Push a value into a buffer; the end of the line through what it then holds. */
w|static real slide(real buffer[WINDOW], real value)
w|{
w|    static const real weights[WINDOW] = {$weights};
w|    real total = $zero;
w|    int i;
w|
w|    for (i = 0; i < WINDOW - 1; i++) {
w|        buffer[i] = buffer[i + 1];
w|        total += weights[i] * buffer[i];
w|    }
w|    buffer[WINDOW - 1] = value;
w|    return total + (weights[WINDOW - 1] * value);
w|}
w|
w|static bool filter(${name}_state *s, const ${name}_tuning *t, int j, real measured)
w|{
w|    real *estimate = s->estimate[j];
w|    real value = measured;
w|    int i;
w|
w|    (void)t;
w|    if (s->samples == 0) {
w|        for (i = 0; i < WINDOW; i++) {
w|            s->window[j][0][i] = measured + ((real)(i - WINDOW) * dt * estimate[1]);
w|            s->window[j][1][i] = estimate[1];
w|            s->window[j][2][i] = estimate[2];
w|        }
w|        estimate[0] = measured - (dt * estimate[1]);
w|    }
w|    for (i = 0; i < 3; i++) {
w|        const real fitted = slide(s->window[j][i], value);
w|
w|        value = (fitted - estimate[i]) / dt;
w|        estimate[i] = fitted;
w|    }
w|    return true;
w|}
l|static bool filter(${name}_state *s, const ${name}_tuning *t, int j, real measured)
l|{
l|    real *x = s->low_pass[j];
l|    const real b = t->bandwidth[j];
l|    real jerk;
l|    int i;
l|
p|    if (s->samples == 0) {
p|        x[2] = s->estimate[j][2];
p|        x[1] = s->estimate[j][1] - (dt * x[2]);
p|        x[0] = measured - ($three * (x[1] + (x[2] / b)) / b);
p|    }
l|    jerk = (b * b * b * (measured - x[0])) - ($three * b * b * x[1]) - ($three * b * x[2]);
l|    x[0] += dt * x[1];
l|    x[1] += dt * x[2];
l|    x[2] += dt * jerk;
l|    for (i = 0; i < 3; i++) {
l|        s->estimate[j][i] = x[i];
l|    }
l|    return true;
l|}
b|static real believed(const ${name}_tuning *t, real position, real velocity, real push)
b|{
b|    return ${name}_believed_acceleration(position, velocity, push, t->believed);
b|}
f|static real believed(const ${name}_tuning *t, real position, real velocity, real push)
f|{
f|    (void)t;
f|    (void)position;
f|    (void)velocity;
f|    return push;
f|}
k|
u|/* Lower root of a matrix of two rows; false: it is not positive definite. */
u|static bool lower_root(real m[2][2], int size, real root[2][2])
u|{
u|    if (!(m[0][0] > $zero)) {
u|        return false;
u|    }
u|    root[0][0] = $sqrt(m[0][0]);
u|    if (size == 2) {
u|        real rest;
u|
u|        root[1][0] = m[1][0] / root[0][0];
u|        rest = m[1][1] - (root[1][0] * root[1][0]);
u|        if (!(rest > $zero)) {
u|            return false;
u|        }
u|        root[1][1] = $sqrt(rest);
u|    }
u|    return true;
u|}
u|
u|/* Sigma points less the mean: a small spread about a large mean would be lost in single precision. */
u|static bool spread(${name}_state *s, int j, real points[POINTS][2])
u|{
u|    real root[2][2] = {{$zero, $zero}, {$zero, $zero}};
u|    const real scale = $spread;
u|    int i;
u|    int k;
u|
u|    if (!lower_root(s->covariance[j], 2, root)) {
u|        return false;
u|    }
u|    for (k = 0; k < 2; k++) {
u|        points[0][k] = $zero;
u|        for (i = 0; i < 2; i++) {
u|            const real column = (k >= i) ? (scale * root[k][i]) : $zero;
u|
u|            points[1 + i][k] = column;
u|            points[3 + i][k] = -column;
u|        }
u|    }
u|    return true;
u|}
u|
u|/* Weighted mean of points less the first of them, whose own weight leaves them out. */
u|static void mean_of(real points[POINTS][2], int size, real mean[2])
u|{
u|    int i;
u|    int k;
u|
u|    for (k = 0; k < size; k++) {
u|        mean[k] = $zero;
u|        for (i = 1; i <= 2; i++) {
u|            mean[k] += $other * (points[i][k] + points[2 + i][k]);
u|        }
u|    }
u|}
u|
u|static real product(real one[POINTS][2], const real mean[2], int a, real two[POINTS][2], const real other[2], int b)
u|{
u|    real total = $first_square * mean[a] * other[b];
u|    int i;
u|
u|    for (i = 1; i < POINTS; i++) {
u|        total += $other * (one[i][a] - mean[a]) * (two[i][b] - other[b]);
u|    }
u|    return total;
u|}
u|
u|static bool correct(${name}_state *s, const ${name}_tuning *t, int j, real points[POINTS][2], real observed[POINTS][2],
u|                    const real error[2], int outputs)
u|{
u|    const int missing = 2 - outputs;
u|    real *mean = s->mean[j];
u|    const real centre[2] = {$zero, $zero}; /* the points are symmetric, and what they observe is linear */
u|    real innovation[2][2] = {{$zero, $zero}, {$zero, $zero}};
u|    real root[2][2] = {{$zero, $zero}, {$zero, $zero}};
u|    real cross[2][2];
u|    real gain[2][2];
u|    int a;
u|    int b;
u|    int k;
u|
u|    for (a = 0; a < outputs; a++) {
u|        for (b = 0; b <= a; b++) {
u|            innovation[a][b] = product(observed, centre, a, observed, centre, b) + t->noise[j][missing + a][missing + b];
u|            innovation[b][a] = innovation[a][b];
u|        }
u|    }
u|    if (!lower_root(innovation, outputs, root)) {
u|        return false;
u|    }
u|    for (a = 0; a < 2; a++) {
u|        real solved[2] = {$zero, $zero};
u|
u|        for (b = 0; b < outputs; b++) {
u|            cross[a][b] = product(points, centre, a, observed, centre, b);
u|            solved[b] = cross[a][b];
u|            for (k = 0; k < b; k++) {
u|                solved[b] -= root[b][k] * solved[k];
u|            }
u|            solved[b] /= root[b][b];
u|        }
u|        for (b = outputs - 1; b >= 0; b--) {
u|            gain[a][b] = solved[b];
u|            for (k = b + 1; k < outputs; k++) {
u|                gain[a][b] -= root[k][b] * gain[a][k];
u|            }
u|            gain[a][b] /= root[b][b];
u|        }
u|    }
u|    for (a = 0; a < 2; a++) {
u|        for (b = 0; b < outputs; b++) {
u|            mean[a] += gain[a][b] * error[b];
u|        }
u|        for (b = 0; b <= a; b++) {
u|            for (k = 0; k < outputs; k++) {
u|                s->covariance[j][a][b] -= cross[a][k] * gain[b][k];
u|            }
u|            s->covariance[j][b][a] = s->covariance[j][a][b];
u|        }
u|    }
u|    return true;
u|}
u|
u|static bool filter(${name}_state *s, const ${name}_tuning *t, int j, real measured)
u|{
u|    real *mean = s->mean[j];
u|    real *estimate = s->estimate[j];
u|    real points[POINTS][2];
u|    real observed[POINTS][2];
u|    real error[2];
u|    real moved[2];
u|    real rest;
u|    real last;
u|    bool right = true;
u|    int i;
u|    int k;
u|
u|    if (s->samples == 0) {
u|        s->past[j] = measured - (dt * estimate[1]);
u|        mean[0] = estimate[1];
u|        mean[1] = measured - (dt * estimate[1]);
u|        s->covariance[j][0][0] = variance[j];
u|        s->covariance[j][1][1] = variance[j];
u|    }
u|    last = mean[0];
u|    if (!spread(s, j, points)) {
u|        return false;
u|    }
u|    rest = believed(t, mean[1], mean[0], s->push[j]);
u|    for (i = 1; i < POINTS; i++) {
u|        points[i][0] += dt * (believed(t, mean[1] + points[i][1], mean[0] + points[i][0], s->push[j]) - rest);
u|        points[i][1] += dt * points[i][0];
u|    }
u|    mean[0] += dt * rest;
u|    mean[1] += dt * mean[0];
u|    mean_of(points, 2, moved);
u|    for (i = 0; i < 2; i++) {
u|        mean[i] += moved[i];
u|        for (k = 0; k <= i; k++) {
u|            s->covariance[j][i][k] = product(points, moved, i, points, moved, k) + t->process[j][i][k];
u|            s->covariance[j][k][i] = s->covariance[j][i][k];
u|        }
u|    }
u|    if (!spread(s, j, points)) {
u|        return false;
u|    }
u|    for (i = 0; i < POINTS; i++) {
u|        observed[i][0] = points[i][0];
u|        observed[i][1] = points[i][1];
u|    }
u|    if (!is_number(measured)) {
u|        s->missing[j] = 1;
u|    } else if (s->missing[j] != 0) { /* there is no difference quotient: the position alone corrects */
u|        for (i = 0; i < POINTS; i++) {
u|            observed[i][0] = observed[i][1];
u|        }
u|        error[0] = measured - mean[1];
u|        error[1] = $zero;
u|        right = correct(s, t, j, points, observed, error, 1);
u|        s->past[j] = measured;
u|        s->missing[j] = 0;
u|    } else {
u|        error[0] = ((measured - s->past[j]) / dt) - mean[0];
u|        error[1] = measured - mean[1];
u|        s->past[j] = measured;
u|        right = correct(s, t, j, points, observed, error, 2);
u|    }
u|    estimate[0] = mean[1];
u|    estimate[1] = mean[0];
a|    estimate[2] = believed(t, estimate[0], estimate[1], s->push[j]);
d|    estimate[2] = (mean[0] - last) / dt;
a|    (void)last;
u|    return right;
u|}
e|static bool filter(${name}_state *s, const ${name}_tuning *t, int j, real measured)
e|{
e|    real *mean = s->mean[j];
e|    real *estimate = s->estimate[j];
e|    real(*p)[STATES] = s->covariance[j];
e|    const real push = s->push[j];
e|    real f[STATES][STATES] = {{$zero}};
e|    real half[STATES][STATES];
e|    real steps[2];
e|    real slopes[2] = {$zero, $zero};
e|    int i;
e|    int k;
e|    int m;
e|
e|    if (s->samples == 0) {
e|        mean[0] = estimate[1];
e|        mean[1] = measured - (dt * estimate[1]);
e|        p[0][0] = variances[j][1];
e|        p[1][1] = variances[j][0];
e|        p[2][2] = variances[j][2];
e|    }
e|    /* Central differences over a millionth of the estimate or of its deviation. */
e|    for (i = 0; i < 2; i++) {
e|        const real deviation = p[i][i] > $zero ? $sqrt(p[i][i]) : $zero;
e|        const real size = magnitude(mean[i]);
e|
e|        steps[i] = $millionth * (size > deviation ? size : deviation);
e|    }
e|    if (steps[1] > $zero) {
e|        slopes[1] = (believed(t, mean[1] + steps[1], mean[0], push) - believed(t, mean[1] - steps[1], mean[0], push))
e|            / ($two * steps[1]);
e|    }
e|    if (steps[0] > $zero) {
e|        slopes[0] = (believed(t, mean[1], mean[0] + steps[0], push) - believed(t, mean[1], mean[0] - steps[0], push))
e|            / ($two * steps[0]);
e|    }
e|    f[0][0] = $one + (dt * slopes[0]);
e|    f[0][1] = dt * slopes[1];
e|    f[0][2] = dt;
e|    for (k = 0; k < STATES; k++) {
e|        f[1][k] = dt * f[0][k];
e|    }
e|    f[1][1] += $one;
e|    f[2][2] = $one;
e|    mean[0] += dt * (believed(t, mean[1], mean[0], push) + mean[2]);
e|    mean[1] += dt * mean[0];
e|    for (i = 0; i < STATES; i++) {
e|        for (k = 0; k < STATES; k++) {
e|            half[i][k] = $zero;
e|            for (m = 0; m < STATES; m++) {
e|                half[i][k] += f[i][m] * p[m][k];
e|            }
e|        }
e|    }
e|    for (i = 0; i < STATES; i++) {
e|        for (k = 0; k <= i; k++) {
e|            p[i][k] = t->process[j][i][k];
e|            for (m = 0; m < STATES; m++) {
e|                p[i][k] += half[i][m] * f[k][m];
e|            }
e|            p[k][i] = p[i][k];
e|        }
e|    }
e|    if (is_number(measured)) {
e|        const real innovation = t->noise[j][0][0] + p[1][1];
e|        const real rest = measured - mean[1];
e|        real cross[STATES];
e|
e|        if (!(innovation > $zero)) {
e|            return false;
e|        }
e|        for (i = 0; i < STATES; i++) {
e|            cross[i] = p[i][1];
e|        }
e|        for (i = 0; i < STATES; i++) {
e|            mean[i] += cross[i] / innovation * rest;
e|            for (k = 0; k <= i; k++) {
e|                p[i][k] -= cross[i] * (cross[k] / innovation);
e|                p[k][i] = p[i][k];
e|            }
e|        }
e|    }
e|    estimate[0] = mean[1];
e|    estimate[1] = mean[0];
e|    estimate[2] = believed(t, estimate[0], estimate[1], push) + mean[2];
e|    return true;
e|}

static real deform(const ${name}_tuning *t, int j, real previous, real response, real desired)
{
    const real *n = t->transformation[j];
    real x = response - desired;

    if (t->robust[j] == 0) {
        x /= n[1];
        return previous + (n[0] * x / ($one + magnitude(x)));
    }
    x *= n[2];
    return previous + ((previous + n[0]) * n[1] * x / ($one + magnitude(x)));
}

void ${name}_start(${name}_state *s, const real position[N], const real velocity[N])
{
    int j;

    (void)memset(s, 0, sizeof(*s));
    for (j = 0; j < N; j++) {
        s->estimate[j][0] = position[j];
        s->estimate[j][1] = velocity[j];
    }
}

static unsigned advance(${name}_state *s, const ${name}_tuning *t, real nominal[3][N], const real measured[N])
{
    unsigned flags = 0u;
    real seen[N];
    real speed[N];
    int i;
    int j;

    for (j = 0; j < N; j++) {
        real z = measured[j];
        real desired;

        if (!is_number(z)) {
            flags |= ${guard}_LOST;
            if (s->samples == 0) {
                return ${guard}_INVALID;
            }
h|            z = s->measured[j];
x|            z = s->measured[j] + (dt * s->estimate[j][1]);
        }
        if (s->samples == 0) {
            s->estimate[j][2] = nominal[2][j];
        }
        if (!filter(s, t, j, z)) {
            return ${guard}_INVALID;
        }
        s->measured[j] = z;
        seen[j] = $seen;
        speed[j] = s->estimate[j][1];
        s->integral[j][0] = nominal[0][j] - seen[j];
        desired = nominal[2][j] + (t->gain[j][GAINS - 1] * (nominal[1][j] - speed[j]));
        desired += t->gain[j][INTEGRALS] * s->integral[j][0];
        for (i = 1; i <= INTEGRALS; i++) {
            if (s->held[j] == 0) {
                s->integral[j][i] += dt * s->integral[j][i - 1];
            }
            desired += t->gain[j][INTEGRALS - i] * s->integral[j][i];
        }
        s->deformed[j] =
            (s->samples == 0) ? desired : deform(t, j, s->deformed[j], s->estimate[j][2], desired);
    }
    ${name}_model_force(seen, speed, s->deformed, t->model, s->force);
    for (j = 0; j < N; j++) {
        const real limit = t->force_limit[j];

        if (!is_number(s->force[j])) {
            return ${guard}_INVALID;
        }
        s->held[j] = (magnitude(s->force[j]) > limit) ? 1 : 0;
        if (s->held[j] != 0) {
            s->force[j] = (s->force[j] > $zero) ? limit : -limit;
            flags |= ${guard}_LIMITED;
        }
    }
    if ((flags & ${guard}_LIMITED) != 0u) {
        ${name}_model_acceleration(seen, speed, s->force, t->model, s->deformed);
    }
    for (j = 0; j < N; j++) {
        if (!is_number(s->deformed[j])) {
            return ${guard}_INVALID;
        }
        s->push[j] = $push;
    }
    s->samples = 1;
    return flags;
}

unsigned ${name}_step(${name}_state *s, const ${name}_tuning *t, real nominal[3][N], const real measured[N], real force[N])
{
    const ${name}_state before = *s;
    const unsigned flags = advance(s, t, nominal, measured);
    int j;

    if ((flags & ${guard}_INVALID) != 0u) {
        *s = before;
    }
    for (j = 0; j < N; j++) {
        force[j] = s->force[j];
    }
    return flags;
}
