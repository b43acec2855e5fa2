#include "$name.h"

#ifdef __FAST_MATH__
#error "the factors need IEEE arithmetic: compile without -ffast-math"
#endif

typedef ${name}_real real;

#define A ${guard}_ACTUATORS
#define N ${guard}_REGRESSORS

static const real forgetting = $forgetting;
static const real allowance = $allowance; /* limit times power that is granted to each regressor */
static const real first[N][N] = {
$first
};
static const real limits[N] = {$limits};

void ${name}_start(${name}_state *s)
{
    int a, i, j;

    for (i = 0; i < N; i++) {
        for (a = 0; a < A; a++)
            s->weights[a][i] = 0;
        for (j = 0; j < N; j++)
            s->factor[i][j] = first[i][j];
        s->limit[i] = limits[i];
        s->power[i] = s->held[i] = 0;
    }
    s->axis = 0;
}

/* Bierman's update of U and D; gain becomes P psi of before, the result is forget + psi' P psi. */
static real update(real u[N][N], const real psi[N], real forget, real gain[N])
{
    const real grow = 1 / forget;
    real inner[N], denominator = forget;
    int i, j;

    for (j = 0; j < N; j++) {
        real total = psi[j];
        for (i = 0; i < j; i++)
            total += u[j][i] * psi[i];
        inner[j] = total;
    }
    for (j = 0; j < N; j++) {
        const real share = u[j][j] * inner[j];
        const real following = denominator + share * inner[j];
        const real turn = inner[j] / denominator;
        u[j][j] *= denominator / following * grow;
        for (i = 0; i < j; i++) {
            const real entry = u[j][i];
            u[j][i] = entry - turn * gain[i];
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
    real variance = s->factor[axis][axis], unit[N], gain[N];
    int j;

    for (j = axis + 1; j < N; j++)
        variance += s->factor[j][axis] * s->factor[j][axis] * s->factor[j][j];
    if (!(variance > limit))
        return;
    for (j = 0; j < N; j++)
        unit[j] = 0;
    unit[axis] = $sqrt(1 / limit - 1 / variance);
    update(s->factor, unit, 1, gain);
    s->held[axis] += (1 - forgetting) * N;
}

int ${name}_update(${name}_state *s, const real regressor[N], const real error[A])
{
    const ${name}_state before = *s;
    real gain[N];
    const real leverage = update(s->factor, regressor, forgetting, gain), shrink = 1 / leverage;
    int a, i, j, usable = leverage >= forgetting && isfinite(leverage);

    for (i = 0; i < N; i++) {
        gain[i] *= shrink;
        for (a = 0; a < A; a++)
            s->weights[a][i] -= error[a] * gain[i];
        s->power[i] = forgetting * s->power[i] + regressor[i] * regressor[i];
        s->held[i] *= forgetting;
        if (s->limit[i] * s->power[i] > allowance)
            s->limit[i] = allowance / s->power[i];
    }
    hold(s, s->axis);
    s->axis = (s->axis + 1) % N;
    for (i = 0; i < N; i++) {
        for (a = 0; a < A; a++)
            usable = usable && isfinite(s->weights[a][i]);
        for (j = 0; j < N; j++)
            usable = usable && isfinite(s->factor[i][j]);
    }
    if (!usable)
        *s = before;
    return usable;
}
