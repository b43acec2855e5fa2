/* $title

   u = W psi from the regressors; the update takes psi and the error, both through the filters of the design.
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
$fields
} ${name}_state;

/* Weights of zero; write others into the struct after it. */
void ${name}_start(${name}_state *s);

/* u = W psi with the regressors as they are measured. */
void ${name}_feed(const ${name}_state *s, const ${name}_real regressor[$regressors], ${name}_real out[$actuators]);

/* One sample of adaptation. Returns 0 where it could not be used: the state is then that of before, safe to hold. */
int ${name}_update(${name}_state *s, const ${name}_real regressor[$regressors],
                   const ${name}_real error[$actuators]);

#ifdef __cplusplus
}
#endif

#endif
