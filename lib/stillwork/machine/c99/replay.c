#include "${name}.h"

#ifdef _WIN32
__declspec(dllexport)
#endif
/* A record through the loop, which starts with these weights, around x+ = a x + now u(k - late) + before u(k - late - 1), of the
   acceleration seen + c x. The weights become the mean of those from the sample `averaged` on. */
void replay(long samples, int states, long late, long begins, long averaged, double *weights, const double *a,
            const double *now, const double *before, const double *c, const double *floor, const double *seen, double limit,
            double *forces, unsigned char *flags, double *x, double *next)
{
    enum { A = ${guard}_AXES, S = ${guard}_SENSORS };
    static ${name}_state s;

    ${name}_start(&s);
    for (int i = 0; i < A; i++)
        s.limit[i] = (${name}_real)limit;
    for (int i = 0; i < A * ${guard}_REGRESSORS; i++) {
        s.weights[i / ${guard}_REGRESSORS][i % ${guard}_REGRESSORS] = weights[i];
        s.adapt.weights[i / ${guard}_REGRESSORS][i % ${guard}_REGRESSORS] = (${name}_real)weights[i];
        weights[i] = (averaged < samples) ? 0.0 : weights[i];
    }
    for (long k = 0; k < samples; k++) {
        ${name}_real read_floor[S], read_platform[A], command[A];

        s.adapting = (k >= begins);
        for (int j = 0; j < S; j++)
            read_floor[j] = (${name}_real)floor[(k * S) + j];
        for (int i = 0; i < A; i++) {
            double sum = seen[(k * A) + i];

            for (int j = 0; j < states; j++)
                sum += c[(i * states) + j] * x[j];
            read_platform[i] = (${name}_real)sum;
        }
        flags[k] = (unsigned char)${name}_step(&s, read_floor, read_platform, command);
        for (int i = 0; i < A; i++)
            forces[(k * A) + i] = (double)command[i];
        for (int i = 0; (k >= averaged) && (i < A * ${guard}_REGRESSORS); i++)
            weights[i] += (double)s.adapt.weights[i / ${guard}_REGRESSORS][i % ${guard}_REGRESSORS] / (double)(samples - averaged);
        for (int i = 0; i < states; i++) {
            next[i] = 0.0;
            for (int j = 0; j < states; j++)
                next[i] += a[(i * states) + j] * x[j];
            for (int j = 0; j < A; j++) {
                next[i] += (k < late) ? 0.0 : now[(i * A) + j] * forces[((k - late) * A) + j];
                next[i] += (k <= late) ? 0.0 : before[(i * A) + j] * forces[((k - late - 1) * A) + j];
            }
        }
        for (int i = 0; i < states; i++)
            x[i] = next[i];
    }
}
