#include "$name.h"

#include <math.h>

#ifdef __FAST_MATH__
#error "the compensated sums need IEEE arithmetic: compile without -ffast-math"
#endif

typedef ${name}_real real;

#define A ${guard}_ACTUATORS
#define N ${guard}_REGRESSORS
m|#define PLACES $places /* of psi and N[u], of now and of the samples of the path's delay */

void ${name}_start(${name}_state *s)
{
    int a;
    int i;
m|    int turn;

    for (a = 0; a < A; a++) {
        for (i = 0; i < N; i++) {
            s->weights[a][i] = $zero;
            s->rest[a][i] = $zero;
        }
    }
m|    for (turn = 0; turn < PLACES; turn++) {
m|        for (i = 0; i < N; i++) {
m|            s->past[turn][i] = $zero;
m|        }
m|        for (a = 0; a < A; a++) {
m|            s->sent[turn][a] = $zero;
m|        }
m|    }
m|    s->turn = 0;
}

void ${name}_feed(const ${name}_state *s, const real regressor[N], real out[A])
{
    int a;
    int i;

    for (a = 0; a < A; a++) {
        out[a] = $zero;
        for (i = 0; i < N; i++) {
            out[a] += s->weights[a][i] * regressor[i];
        }
    }
}

m|/* Keep psi and N[u] of this sample. */
m|void ${name}_pass(${name}_state *s, const real regressor[N], const real command[A])
m|{
m|    int a;
m|    int i;
m|
m|    for (i = 0; i < N; i++) {
m|        s->past[s->turn][i] = regressor[i];
m|    }
m|    for (a = 0; a < A; a++) {
m|        s->sent[s->turn][a] = command[a];
m|    }
m|    s->turn = (s->turn + 1) % PLACES;
m|}
m|
m|/* psi of as many samples ago as the path is late, and the modified error of the weights of now. */
m|static void modify(const ${name}_state *s, const real given[A], real regressor[N], real error[A])
m|{
m|    const int then = s->turn; /* the oldest place is the next one */
m|    int a;
m|    int i;
m|
m|    for (i = 0; i < N; i++) {
m|        regressor[i] = s->past[then][i];
m|    }
m|    for (a = 0; a < A; a++) {
m|        error[a] = given[a] - s->sent[then][a];
m|        for (i = 0; i < N; i++) {
m|            error[a] += s->weights[a][i] * regressor[i];
m|        }
m|    }
m|}
m|
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
