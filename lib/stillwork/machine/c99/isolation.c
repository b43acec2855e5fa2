#include "$name.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#ifdef __FAST_MATH__
#error "missing numbers need IEEE arithmetic: compile without -ffast-math"
#endif

#define A ${guard}_AXES
#define S ${guard}_SENSORS
#define N ${guard}_REGRESSORS
#define POWER $power_sections /* sections of one weak integrator */

/* Samples until the filters of the floor sensors, which start from rest, have settled; in which the feedforward then
   rises to its whole; and after the limit acted until the error belongs to an unlimited command again. */
static const int start_samples = $start;
static const int fade_samples = $fade;
static const int pause_samples = $pause;

/* One section, transposed direct form II. */
static double section(const double c[5], double *first, double *second, double value)
{
    const double result = (c[0] * value) + *first;

    *first = (c[1] * value) - (c[3] * result) + *second;
    *second = (c[2] * value) - (c[4] * result);
    return result;
}

static void product(const double matrix[A][A], const double from[A], double to[A])
{
    int a;
    int b;

    for (a = 0; a < A; a++) {
        to[a] = 0.0;
        for (b = 0; b < A; b++) {
            to[a] += matrix[a][b] * from[b];
        }
    }
}

void ${name}_start(${name}_state *s)
{
    static const ${name}_real designed[A][N] = {
$weights    };
    int a;
    int i;

    (void)memset(s, 0, sizeof(*s));
    ${name}_adapt_start(&s->adapt);
    for (a = 0; a < A; a++) {
        s->limit[a] = $limit;
        for (i = 0; i < N; i++) {
            s->adapt.weights[a][i] = designed[a][i];
            s->weights[a][i] = (double)designed[a][i];
        }
    }
    s->adapting = 1;
    s->level = 1.0;
    s->rest = start_samples + fade_samples;
    s->wait = s->rest + pause_samples;
}

void ${name}_store(const ${name}_state *s, ${name}_real stored[${guard}_STORED])
{
    int place = 0;
    int a;
    int i;
r|    int j;

    for (i = 0; i < N; i++) {
        for (a = 0; a < A; a++) {
            stored[place] = s->adapt.weights[a][i];
            place++;
        }
r|        for (j = 0; j <= i; j++) {
r|            stored[place] = s->adapt.factor[i][j];
r|            place++;
r|        }
    }
}

int ${name}_restore(${name}_state *s, const ${name}_real stored[${guard}_STORED])
{
    int place = 0;
    int usable = 1;
    int a;
    int i;
r|    int j;

    ${name}_start(s);
    for (i = 0; i < N; i++) {
        for (a = 0; a < A; a++) {
            s->adapt.weights[a][i] = stored[place];
            s->weights[a][i] = (double)stored[place];
            usable = (isfinite(stored[place]) != 0) ? usable : 0;
            place++;
        }
r|        for (j = 0; j <= i; j++) {
r|            s->adapt.factor[i][j] = stored[place];
r|            usable = ((isfinite(stored[place]) != 0) && ((j < i) || (stored[place] > $zero))) ? usable : 0;
r|            place++;
r|        }
    }
    if (usable == 0) {
        ${name}_start(s);
    }
    return usable;
}

/* Whether the floor's slow motion is above its level, which a floor that stays louder raises, as far as the adaptation is
   certified, and a calm one lowers again. */
static bool loud(${name}_state *s, const double psi[N])
{
    static const double guard[N][N] = {
$guard_rows    };
    double square = 0.0;
    bool above;
    int i;
    int j;

    for (i = 0; i < N; i++) {
        double sum = 0.0;

        for (j = i; j < N; j++) {
            sum += guard[i][j] * psi[j];
        }
        square += sum * sum;
    }
    above = !(square <= s->level);
    s->level *= above ? $rise : $fall;
    s->level = (s->level > $highest) ? $highest : s->level;
    s->level = (s->level < 1.0) ? 1.0 : s->level;
    return above;
}

/* Keep what is there; false: a sensor is missing, and its last value stands for it. */
static bool take(${name}_real kept[], const ${name}_real given[], int count)
{
    bool whole = true;
    int i;

    for (i = 0; i < count; i++) {
        if (isfinite(given[i]) != 0) {
            kept[i] = given[i];
        } else {
            whole = false;
        }
    }
    return whole;
}

/* One sample of the filters, the command and the update; returns flags. */
static unsigned advance(${name}_state *s, ${name}_real out[A])
{
    static const double skyhook[$skyhook_sections][5] = {
$skyhook    };
    static const double shaping[$shaping_sections][5] = {
$shaping    };
    static const double highpass[$highpass_sections][5] = {
$highpass    };
    static const double integrator[POWER][5] = {
$integrator    };
    static const double modes[A][$error_sections][5] = {
$modes    };
    static const double folded[A][A] = {
$folded    };
    static const double before[A][A] = {
$before    };
    static const double after[A][A] = {
$after    };
    unsigned flags = 0u;
    double stepped[A];
    double damping[A];
    double axes[A];
    double error[A];
    double both[$both];
    ${name}_real share;
    ${name}_real e[A];
    double psi[N];
    ${name}_real filtered[N];
    double sent[A];
    ${name}_real c[A];
    int place = 0;
    int a;
    int i;
    int k;
    int p;

    /* The filtered error N P2^-1 a1, mode by mode, and the skyhook, of readings without what sampling folds of the steps of
       the held command. */
    for (a = 0; a < A; a++) {
        stepped[a] = s->past[$late - 1][a] - s->past[$late][a];
    }
    product(folded, stepped, error);
    for (a = 0; a < A; a++) {
        damping[a] = (double)s->platform[a] - error[a];
        error[a] = damping[a];
        for (k = 0; k < $skyhook_sections; k++) {
            damping[a] = section(skyhook[k], &s->skyhook[k][0][a], &s->skyhook[k][1][a], damping[a]);
        }
    }
    product(before, error, axes);
    for (a = 0; a < A; a++) {
        for (k = 0; k < $error_sections; k++) {
            axes[a] = section(modes[a][k], &s->error[k][0][a], &s->error[k][1][a], axes[a]);
        }
    }
    product(after, axes, error);

    /* The regressors psi from the floor without its slow motion, and N psi: N first, then the weak integrators of both. */
    for (i = 0; i < S; i++) {
        both[i] = (double)s->floor[i];
        for (k = 0; k < $highpass_sections; k++) {
            both[i] = section(highpass[k], &s->highpass[k][0][i], &s->highpass[k][1][i], both[i]);
        }
        both[S + i] = both[i];
        for (k = 0; k < $shaping_sections; k++) {
            both[S + i] = section(shaping[k], &s->shaping[k][0][i], &s->shaping[k][1][i], both[S + i]);
        }
    }
    for (p = 0; p <= $powers; p++) {
        for (i = 0; i < $both; i++) {
            for (k = (p - 1) * POWER; (p > 0) && (k < (p * POWER)); k++) {
                both[i] = section(integrator[k % POWER], &s->integrator[k][0][i], &s->integrator[k][1][i], both[i]);
            }
        }
        for (i = 0; i < S; i++) {
            psi[place] = both[i];
            filtered[place] = (${name}_real)both[S + i];
            place++;
        }
    }

    /* The command, its feedforward from nothing once an offset has left the filters, and its limit: weights do not learn
       from a force that was cut off. */
    share = (s->rest < fade_samples) ? (${name}_real)(1.0 - ((double)s->rest / (double)fade_samples)) : $zero;
    share = share * share * ($three - ($two * share));
    for (a = 0; a < A; a++) {
        double feed = 0.0;

        for (i = 0; i < N; i++) {
            s->weights[a][i] += $smooth * ((double)s->adapt.weights[a][i] - s->weights[a][i]);
            feed += s->weights[a][i] * psi[i];
        }
        out[a] = (share * (${name}_real)feed) - (${name}_real)damping[a];
        e[a] = (${name}_real)error[a];
        if (!(out[a] <= s->limit[a])) {
            out[a] = s->limit[a];
            flags |= ${guard}_SATURATED;
        }
        if (out[a] < -s->limit[a]) {
            out[a] = -s->limit[a];
            flags |= ${guard}_SATURATED;
        }
    }

    /* N on the command, for the modified error. */
    for (a = 0; a < A; a++) {
        sent[a] = (double)out[a];
        for (k = 0; k < $shaping_sections; k++) {
            sent[a] = section(shaping[k], &s->sent[k][0][a], &s->sent[k][1][a], sent[a]);
        }
        c[a] = (${name}_real)sent[a];
    }
    if (loud(s, psi)) {
        flags |= ${guard}_LOUD;
    }
    if ((flags & (${guard}_SATURATED | ${guard}_LOUD)) != 0u) {
        s->wait = (s->wait > pause_samples) ? s->wait : pause_samples;
    }
    s->rest -= (s->rest > 0) ? 1 : 0;
    if ((s->adapting == 0) || (s->wait > 0)) {
        flags |= ${guard}_FROZEN;
        s->wait -= (s->wait > 0) ? 1 : 0;
        ${name}_adapt_pass(&s->adapt, filtered, c);
    } else if (${name}_adapt_update(&s->adapt, filtered, c, e) == 0) {
        flags |= ${guard}_INVALID | ${guard}_FROZEN;
    } else {
        /* adapted */
    }
    return flags;
}

unsigned ${name}_step(${name}_state *s, const ${name}_real floor[S], const ${name}_real platform[A],
                    ${name}_real out[A])
{
    static const int patience = $patience; /* for how many samples a missing sensor is held */
    unsigned flags = 0u;
    bool whole;
    int a;

    whole = take(s->floor, floor, S);
    whole = take(s->platform, platform, A) && whole;
    s->missing = whole ? 0 : (s->missing + 1);
    if (!whole) {
        flags |= ${guard}_HELD;
        s->wait = (s->wait > pause_samples) ? s->wait : pause_samples;
    }
    if (s->missing > patience) { /* nothing to go by: no force, and the filters stand still */
        flags |= ${guard}_INVALID | ${guard}_FROZEN;
        s->missing = patience + 1;
        s->rest = start_samples + fade_samples; /* the floor goes on elsewhere: a step, as at the start */
        s->wait = s->rest + pause_samples;
        for (a = 0; a < A; a++) {
            out[a] = $zero;
        }
    } else {
        flags |= advance(s, out);
    }
    (void)memmove(s->past[1], s->past[0], sizeof(s->past) - sizeof(s->past[0]));
    for (a = 0; a < A; a++) {
        s->past[0][a] = (double)out[a];
    }
    return flags;
}
