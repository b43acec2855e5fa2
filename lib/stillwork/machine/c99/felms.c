#include "$name.h"

#include <math.h>

#ifdef __FAST_MATH__
#error "the compensated sums need IEEE arithmetic: compile without -ffast-math"
#endif

$shared

void ${name}_start(${name}_state *s)
{
    int a;
    int i;

    for (a = 0; a < A; a++) {
        for (i = 0; i < N; i++) {
            s->weights[a][i] = $zero;
            s->rest[a][i] = $zero;
        }
    }
m|    empty(s);
}

p|int ${name}_update(${name}_state *s, const real regressor[N], const real error[A])
m|int ${name}_update(${name}_state *s, const real now[N], const real command[A], const real given[A])
{
    real power = $zero;
    real rate;
    int a;
    int i;
    int usable = 1;
m|    real regressor[N];
m|    real error[A];

m|    ${name}_pass(s, now, command);
m|    modify(s, given, regressor, error);
    for (i = 0; i < N; i++) {
        power += regressor[i] * regressor[i];
    }
    rate = $step_size / ($regularisation + ($copies * power));
    for (a = 0; a < A; a++) {
        for (i = 0; i < N; i++) { /* what it would become is finite, or the weights stay */
            if (isfinite(s->weights[a][i] - (rate * error[a] * regressor[i])) == 0) {
                usable = 0;
            }
        }
    }
    if (usable != 0) {
        for (a = 0; a < A; a++) {
            for (i = 0; i < N; i++) {
                const real step = s->rest[a][i] - (rate * error[a] * regressor[i]);
                const real next = s->weights[a][i] + step;

                s->rest[a][i] = step - (next - s->weights[a][i]);
                s->weights[a][i] = next;
            }
        }
    }
    return usable;
}
