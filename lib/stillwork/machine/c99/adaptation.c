typedef ${name}_real real;

#define A ${guard}_ACTUATORS
#define N ${guard}_REGRESSORS
m|#define PLACES $places /* of psi and N[u], of now and of the samples of the path's delay */

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
m|/* No sample is kept yet. */
m|static void empty(${name}_state *s)
m|{
m|    int turn;
m|    int a;
m|    int i;
m|
m|    for (turn = 0; turn < PLACES; turn++) {
m|        for (i = 0; i < N; i++) {
m|            s->past[turn][i] = $zero;
m|        }
m|        for (a = 0; a < A; a++) {
m|            s->sent[turn][a] = $zero;
m|        }
m|    }
m|    s->turn = 0;
m|}
m|
