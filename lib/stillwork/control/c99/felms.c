#include "$name.h"

#ifdef __FAST_MATH__
#error "the compensated sums need IEEE arithmetic: compile without -ffast-math"
#endif

typedef ${name}_real real;

#define A ${guard}_ACTUATORS
#define N ${guard}_REGRESSORS

void ${name}_start(${name}_state *s)
{
    int a, i;

    for (a = 0; a < A; a++)
        for (i = 0; i < N; i++)
            s->weights[a][i] = s->rest[a][i] = 0;
}

int ${name}_update(${name}_state *s, const real regressor[N], const real error[A])
{
    real power = 0, rate;
    int a, i;

    for (i = 0; i < N; i++)
        power += regressor[i] * regressor[i];
    rate = $step_size / ($regularisation + $copies * power);
    for (a = 0; a < A; a++)
        for (i = 0; i < N; i++) /* what it would become is finite, or the weights stay */
            if (!isfinite(s->weights[a][i] - rate * error[a] * regressor[i]))
                return 0;
    for (a = 0; a < A; a++)
        for (i = 0; i < N; i++) {
            const real step = s->rest[a][i] - rate * error[a] * regressor[i];
            const real next = s->weights[a][i] + step;
            s->rest[a][i] = step - (next - s->weights[a][i]);
            s->weights[a][i] = next;
        }
    return 1;
}
