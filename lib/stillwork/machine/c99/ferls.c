#include "$name.h"

#include <math.h>
#include <stdbool.h>

#ifdef __FAST_MATH__
#error "the factors need IEEE arithmetic: compile without -ffast-math"
#endif

$shared

static const real forgetting = $forgetting;

void ${name}_start(${name}_state *s)
{
    static const real first[N][N] = {
$first
    };
    static const real limits[N] = {$limits};
    int a;
    int i;
    int j;

    for (i = 0; i < N; i++) {
        for (a = 0; a < A; a++) {
            s->weights[a][i] = $zero;
        }
        for (j = 0; j < N; j++) {
            s->factor[i][j] = first[i][j];
        }
        s->limit[i] = limits[i];
        s->power[i] = $zero;
        s->held[i] = $zero;
    }
    s->axis = 0;
m|    empty(s);
}

/* Bierman's update of U and D; gain becomes P psi of before, the result is forget + psi' P psi. */
static real update(real u[N][N], const real psi[N], real forget, real gain[N])
{
    const real grow = $one / forget;
    real inner[N];
    real denominator = forget;
    int i;
    int j;

    for (j = 0; j < N; j++) {
        inner[j] = psi[j];
        for (i = 0; i < j; i++) {
            inner[j] += u[j][i] * psi[i];
        }
    }
    for (j = 0; j < N; j++) {
        const real share = u[j][j] * inner[j];
        const real following = denominator + (share * inner[j]);
        const real turn = inner[j] / denominator;

        u[j][j] *= denominator / following * grow;
        for (i = 0; i < j; i++) {
            const real entry = u[j][i];

            u[j][i] = entry - (turn * gain[i]);
            gain[i] += share * entry;
        }
        gain[j] = share;
        denominator = following;
    }
    return denominator;
}

/* Keep one variance, another one each sample, below its limit: as if its regressor had been seen once more. */
static void hold(${name}_state *s, int axis)
{
    const real limit = s->limit[axis];
    real variance = s->factor[axis][axis];
    int j;

    for (j = axis + 1; j < N; j++) {
        variance += s->factor[j][axis] * s->factor[j][axis] * s->factor[j][j];
    }
    if (variance > limit) {
        real unit[N];
        real gain[N];

        for (j = 0; j < N; j++) {
            unit[j] = $zero;
        }
        unit[axis] = $sqrt(($one / limit) - ($one / variance));
        (void)update(s->factor, unit, $one, gain);
        s->held[axis] += ($one - forgetting) * (real)N;
    }
}

p|int ${name}_update(${name}_state *s, const real regressor[N], const real error[A])
m|int ${name}_update(${name}_state *s, const real now[N], const real command[A], const real given[A])
{
    const real allowance = $allowance; /* limit times power that is granted to each regressor */
    ${name}_state before;
    real gain[N];
    real leverage;
    real shrink;
    bool usable;
    int a;
    int i;
    int j;
m|    real regressor[N];
m|    real error[A];

m|    ${name}_pass(s, now, command);
m|    modify(s, given, regressor, error);
    before = *s;
    leverage = update(s->factor, regressor, forgetting, gain);
    shrink = $one / leverage;
    usable = (leverage >= forgetting) && (isfinite(leverage) != 0);
    for (i = 0; i < N; i++) {
        gain[i] *= shrink;
        for (a = 0; a < A; a++) {
            s->weights[a][i] -= error[a] * gain[i];
        }
        s->power[i] = (forgetting * s->power[i]) + (regressor[i] * regressor[i]);
        s->held[i] *= forgetting;
        if ((s->limit[i] * s->power[i]) > allowance) {
            s->limit[i] = allowance / s->power[i];
        }
    }
    hold(s, s->axis);
    s->axis = (s->axis + 1) % N;
    for (i = 0; i < N; i++) {
        for (a = 0; a < A; a++) {
            usable = usable && (isfinite(s->weights[a][i]) != 0);
        }
        for (j = 0; j < N; j++) {
            usable = usable && (isfinite(s->factor[i][j]) != 0);
        }
    }
    if (!usable) {
        *s = before;
    }
    return usable ? 1 : 0;
}
