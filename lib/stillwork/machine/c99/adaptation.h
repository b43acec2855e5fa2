/* $title

   u = W psi from the regressors; the update takes psi and the error, both through the filters of the design.
m|   It follows the modified error, e(k) - N[u](k - d) + W(k) psi(k - d) with psi(k - d), d = $delay samples: its command is
m|   u = W psi as it was sent, through the filter of psi. Each sample is either updated or passed.
   One struct holds all of it: nothing is allocated, and several may run side by side. */

#ifndef ${guard}_H
#define ${guard}_H

#ifdef __cplusplus
extern "C" {
#endif

#define ${guard}_ACTUATORS $actuators
#define ${guard}_REGRESSORS $regressors

typedef $real ${name}_real;

typedef struct {
    ${name}_real weights[$actuators][$regressors]; /* W */
m|    ${name}_real past[$places][$regressors]; /* psi of the last samples, in turn */
m|    ${name}_real sent[$places][$actuators];  /* N[u] likewise */
m|    int turn;                  /* the place of the next */
$fields
} ${name}_state;

/* Weights of zero; write others into the struct after it. */
void ${name}_start(${name}_state *s);

/* u = W psi with the regressors as they are measured. */
void ${name}_feed(const ${name}_state *s, const ${name}_real regressor[$regressors], ${name}_real out[$actuators]);

/* One sample of adaptation. Returns 0 where it could not be used: the state is then that of before, safe to hold. */
p|int ${name}_update(${name}_state *s, const ${name}_real regressor[$regressors],
p|                   const ${name}_real error[$actuators]);
m|int ${name}_update(${name}_state *s, const ${name}_real regressor[$regressors],
m|                   const ${name}_real command[$actuators], const ${name}_real given[$actuators]);

m|/* One sample in which the weights stay. */
m|void ${name}_pass(${name}_state *s, const ${name}_real regressor[$regressors],
m|                 const ${name}_real command[$actuators]);

#ifdef __cplusplus
}
#endif

#endif
