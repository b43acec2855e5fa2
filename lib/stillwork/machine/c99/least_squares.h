/* $title

   y = coef x + intercept by the triangle of all rows, each turned into it by rotations.
   One struct holds all of it: nothing is allocated, and several may run side by side. */

#ifndef ${guard}_H
#define ${guard}_H

#ifdef __cplusplus
extern "C" {
#endif

#define ${guard}_FEATURES $features
#define ${guard}_OUTPUTS $outputs

typedef $real ${name}_real;

typedef struct {
    ${name}_real triangle[$features][$columns]; /* R of weighted deviations, beside it Q'y */
    ${name}_real mean[$columns]; /* weighted, of each feature and output */
    ${name}_real power[$columns]; /* of each feature; of each output what no feature explains */
    ${name}_real peak[$features]; /* largest |R_jj| so far */
    ${name}_real held[$features]; /* share of the last time constant in which row j was held */
    ${name}_real mass; /* sum of the weights */
} ${name}_state;

void ${name}_start(${name}_state *s);

/* One row more. Returns 0 where it was lost, because a number is not finite or the weight not above zero: time passes. */
int ${name}_learn(${name}_state *s, const ${name}_real x[$features], const ${name}_real y[$outputs],
                  ${name}_real weight);

/* The estimate of all rows so far; a feature that those before it explain gets 0. */
void ${name}_solve(const ${name}_state *s, ${name}_real coef[$outputs][$features],
                   ${name}_real intercept[$outputs]);

#ifdef __cplusplus
}
#endif

#endif
