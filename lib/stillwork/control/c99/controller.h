/* $title

   $signals

   One struct holds all of it: nothing is allocated, no library is called, and several may run side by side. */

#ifndef ${guard}_H
#define ${guard}_H

#define ${guard}_INPUTS $inputs
#define ${guard}_OUTPUTS $outputs
#define ${guard}_SAMPLE_TIME $sample_time /* s */

typedef $real ${name}_real;

typedef struct {
    ${name}_real state[$states];
    ${name}_real rest[$states]; /* what rounding has left of each state */$ring
} ${name}_state;

/* Take over without a bump: where the controller has such a rest, these inputs held would keep these outputs, and in
   any case the next step gives them. Call it once before the first step, and when control is taken up again. */
void ${name}_start(${name}_state *s, const ${name}_real in[$inputs], const ${name}_real out[$outputs]);

/* One sample: from what was measured to what acts until the next one$late. Inputs must be finite. */
void ${name}_step(${name}_state *s, const ${name}_real in[$inputs], ${name}_real out[$outputs]);

#endif
