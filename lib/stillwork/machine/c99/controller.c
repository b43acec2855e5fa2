#include "$name.h"

#include <math.h>
#include <stdbool.h>

#ifdef __FAST_MATH__
#error "missing numbers and compensated sums need IEEE arithmetic: compile without -ffast-math"
#endif

#define INPUTS ${guard}_INPUTS
#define OUTPUTS ${guard}_OUTPUTS
x|#define STATES ${guard}_STATES
d|#define LATE $delay

typedef ${name}_real real;

const ${name}_tuning ${name}_designed = {
$designed};

static bool is_number(real value)
{
    return isfinite(value) != 0;
}

static real limited(real value, real low, real high)
{
    real found = value;

    if (found < low) {
        found = low;
    }
    if (found > high) {
        found = high;
    }
    return found;
}

/* Keep what is there; false: something is missing, and the last one stands for it. */
static bool take(${name}_state *s, const real in[INPUTS], const real known[OUTPUTS])
{
    bool whole = true;
    int i;

    for (i = 0; i < INPUTS; i++) {
        if (is_number(in[i])) {
            s->in[i] = in[i];
        } else {
            whole = false;
        }
    }
    for (i = 0; i < OUTPUTS; i++) {
        if (is_number(known[i])) {
            s->known[i] = known[i];
        } else {
            whole = false;
        }
    }
    return whole;
}

unsigned ${name}_start(${name}_state *s, const ${name}_tuning *t, const real in[INPUTS], const real known[OUTPUTS],
                    const real out[OUTPUTS])
{
    unsigned flags = 0u;
    int i;

    if (!take(s, in, known)) {
        flags = ${guard}_INVALID;
    }
    for (i = 0; i < OUTPUTS; i++) {
        if (!is_number(out[i])) {
            flags = ${guard}_INVALID;
        }
    }
    if (flags == 0u) {
E|        real e[INPUTS];
F|        real f[OUTPUTS];

        for (i = 0; i < OUTPUTS; i++) {
            s->out[i] = limited(out[i], t->low[i], t->high[i]);
        }
E|        for (i = 0; i < INPUTS; i++) {
E|            e[i] = t->gain[i] * s->in[i];
E|        }
F|        for (i = 0; i < OUTPUTS; i++) {
F|            f[i] = s->out[i] - s->known[i];
F|        }
x|        for (i = 0; i < STATES; i++) {
x|            s->rest[i] = $zero;
x|        }
$start        s->missing = 0;
d|        for (i = 0; i < LATE; i++) {
d|            int j;
d|
d|            for (j = 0; j < OUTPUTS; j++) {
d|                s->ring[i][j] = s->out[j];
d|            }
d|        }
d|        s->place = 0;
    }
    return flags;
}

unsigned ${name}_step(${name}_state *s, const ${name}_tuning *t, const real in[INPUTS], const real known[OUTPUTS],
                    real out[OUTPUTS])
{
x|    /* 1 where a state changes by little each sample: it is summed up, with what rounding leaves; 0: it is set. */
x|    static const real keeps[STATES] = {$keeps};
x|    const real *x = s->state;
x|    real change[STATES];
x|    real next[STATES];
x|    real rest[STATES];
e|    real e[INPUTS];
    real v[OUTPUTS];
    real acts[OUTPUTS];
f|    real f[OUTPUTS];
w|    real w[OUTPUTS];
    unsigned flags = 0u;
    unsigned limits = 0u;
    bool valid = true;
    int i;

    if (take(s, in, known)) {
        s->missing = 0;
    } else {
        flags |= ${guard}_HELD;
        if (s->missing < t->patience) {
            s->missing++;
        } else {
            valid = false;
        }
    }
e|    for (i = 0; i < INPUTS; i++) {
e|        e[i] = t->gain[i] * s->in[i];
e|    }

    /* What is asked for, and what acts. */
$commands    for (i = 0; i < OUTPUTS; i++) {
        v[i] += s->known[i];
        acts[i] = limited(v[i], t->low[i], t->high[i]);
        valid = valid && is_number(v[i]);
        if (acts[i] != v[i]) {
            limits = ${guard}_SATURATED;
        }
f|        f[i] = acts[i] - s->known[i];
w|        w[i] = acts[i] - v[i];
    }
x|
x|    /* The next states. */
x|$changes
x|    for (i = 0; i < STATES; i++) {
x|        const real kept = keeps[i] * x[i];
x|        const real step = change[i] + s->rest[i];
x|
x|        next[i] = kept + step;
x|        rest[i] = step - (next[i] - kept);
x|        valid = valid && is_number(next[i]);
x|    }

    if (valid) {
        flags |= limits;
x|        for (i = 0; i < STATES; i++) {
x|            s->state[i] = next[i];
x|            s->rest[i] = rest[i];
x|        }
n|        for (i = 0; i < OUTPUTS; i++) {
n|            s->out[i] = acts[i];
n|        }
d|        for (i = 0; i < OUTPUTS; i++) {
d|            s->out[i] = s->ring[s->place][i];
d|            s->ring[s->place][i] = acts[i];
d|        }
d|        s->place = (s->place + 1) % LATE;
    } else {
        flags |= ${guard}_INVALID;
    }
    for (i = 0; i < OUTPUTS; i++) {
        out[i] = s->out[i];
    }
    return flags;
}
