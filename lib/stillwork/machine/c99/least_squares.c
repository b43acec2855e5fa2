#include "$name.h"

#include <math.h>
#include <stdbool.h>

#ifdef __FAST_MATH__
#error "the triangle needs IEEE arithmetic: compile without -ffast-math"
#endif

typedef ${name}_real real;

#define N ${guard}_FEATURES
#define M ${guard}_OUTPUTS
#define C (N + M)

static const real forgetting = $forgetting;
static const real least_share = $share; /* of |R_jj| over its peak */
static const real singular = $singular; /* |R_jj| over the size of feature j, below which others explain it */

void ${name}_start(${name}_state *s)
{
    static const real first[N][C] = {
$first
    };
    static const real power[N] = {$power};
    int i;
    int j;

    for (j = 0; j < C; j++) {
        s->mean[j] = $zero;
        s->power[j] = (j < N) ? power[j % N] : $zero;
    }
    for (i = 0; i < N; i++) {
        for (j = 0; j < C; j++) {
            s->triangle[i][j] = first[i][j];
        }
        s->peak[i] = first[i][i];
        s->held[i] = $zero;
    }
    s->mass = $zero;
}

/* The triangle with one row more; of the row is left what the features do not explain. */
static void add_row(real triangle[N][C], real row[C])
{
    int j;
    int k;

    for (k = 0; k < N; k++) {
        const real whole = triangle[k][k];
        const real length = $sqrt((whole * whole) + (row[k] * row[k]));
        real along;
        real across;

        if ((row[k] == $zero) || (length == $zero)) {
            continue;
        }
        along = whole / length;
        across = row[k] / length;
        triangle[k][k] = length;
        for (j = k + 1; j < C; j++) {
            const real upper = triangle[k][j];

            triangle[k][j] = (along * upper) + (across * row[j]);
            row[j] = (along * row[j]) - (across * upper);
        }
    }
}

static void forget(${name}_state *s)
{
    const real root = $sqrt(forgetting);
    int i;
    int j;

    for (i = 0; i < N; i++) {
        for (j = i; j < C; j++) {
            s->triangle[i][j] *= root;
        }
        s->held[i] *= forgetting;
    }
    for (j = 0; j < C; j++) {
        s->power[j] *= forgetting;
    }
    s->mass *= forgetting;
}

/* Rows that nothing excites: as if their combination of features were seen again with what the estimate says. */
static void hold(${name}_state *s)
{
    int j;
    int k;

    for (j = 0; j < N; j++) {
        const real pivot = $fabs(s->triangle[j][j]);
        const real peak = s->peak[j];
        real least = $two * singular * $sqrt(s->power[j]);

        if (pivot > peak) {
            s->peak[j] = pivot;
            continue;
        }
        least = (peak > least) ? least : $zero;
        least = ((least_share * peak) > least) ? (least_share * peak) : least;
        if ((pivot > $zero) && (pivot < least)) {
            for (k = j; k < C; k++) {
                s->triangle[j][k] *= least / pivot;
            }
            s->held[j] += $one - forgetting;
        }
    }
}

int ${name}_learn(${name}_state *s, const real x[N], const real y[M], real weight)
{
    real row[C];
    bool used = (weight > $zero) && (isfinite(weight) != 0);
    int j;

    for (j = 0; j < C; j++) {
        row[j] = (j < N) ? x[j % N] : y[(j - N) % M];
        used = used && (isfinite(row[j]) != 0);
    }
    if (forgetting < $one) {
        forget(s);
    }
    if (used) {
        real root = $sqrt(weight);
C|        const real mass = s->mass;
C|        const real gain = weight / (mass + weight);

        s->mass += weight;
        for (j = 0; j < N; j++) {
            s->power[j] += weight * row[j] * row[j];
        }
C|        root *= $sqrt(mass / (mass + weight));
C|        for (j = 0; j < C; j++) {
C|            row[j] -= s->mean[j];
C|            s->mean[j] += gain * row[j];
C|        }
        for (j = 0; j < C; j++) {
            row[j] *= root;
        }
        add_row(s->triangle, row);
        for (j = N; j < C; j++) {
            s->power[j] += row[j] * row[j];
        }
    }
    if (forgetting < $one) {
        hold(s);
    }
    return used ? 1 : 0;
}

void ${name}_solve(const ${name}_state *s, real coef[M][N], real intercept[M])
{
    real triangle[N][C];
    real row[C];
    int i;
    int j;
    int k;

    for (i = 0; i < N; i++) {
        for (j = 0; j < C; j++) {
            triangle[i][j] = s->triangle[i][j];
        }
    }
    for (j = 0; j < N; j++) {
        if (!($fabs(triangle[j][j]) > (singular * $sqrt(s->power[j])))) {
            /* what is left of its row belongs to the features after it */
            for (k = 0; k < C; k++) {
                row[k] = (k > j) ? triangle[j][k] : $zero;
                triangle[j][k] = $zero;
            }
            add_row(triangle, row);
        }
    }
    for (k = 0; k < M; k++) {
        for (i = N - 1; i >= 0; i--) {
            coef[k][i] = $zero;
            if (triangle[i][i] != $zero) {
                real total = triangle[i][N + k];

                for (j = i + 1; j < N; j++) {
                    total -= triangle[i][j] * coef[k][j];
                }
                coef[k][i] = total / triangle[i][i];
            }
        }
        intercept[k] = $zero;
C|        intercept[k] = s->mean[N + k];
C|        for (i = 0; i < N; i++) {
C|            intercept[k] -= coef[k][i] * s->mean[i];
C|        }
    }
}
