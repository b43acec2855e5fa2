/* $title

   floor: m/s^2 at each floor sensor; platform: m/s^2 along each actuator; out: N. Call ${name}_start once, then
   ${name}_step each sample. Nothing is allocated, and several may run side by side. */

#ifndef ${guard}_H
#define ${guard}_H

#include "${name}_adapt.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ${guard}_AXES $axes
#define ${guard}_SENSORS $sensors
#define ${guard}_REGRESSORS $regressors
#define ${guard}_STORED $stored
#define ${guard}_SAMPLE_TIME $sample_time /* s */

/* Flags of a sample; 0: none. */
#define ${guard}_SATURATED 1u /* the limit of the force acts */
#define ${guard}_HELD 2u      /* a sensor is missing, not a number: the last value stands for it */
#define ${guard}_FROZEN 4u    /* the weights did not adapt */
#define ${guard}_INVALID 8u   /* missing for too long, or an adaptation that could not be used */
#define ${guard}_LOUD 16u     /* the floor's slow motion is above its level: the weights are kept */

typedef ${name}_adapt_real ${name}_real;

typedef struct {
    ${name}_adapt_state adapt; /* the weights W and what their update keeps */
    double weights[$axes][$regressors]; /* of the command: W without its fast motion */
    ${name}_real limit[$axes];   /* N, of each command; may be changed between two samples */
    int adapting;              /* 0: the weights are kept; likewise */
    int rest;                  /* samples until the feedforward is whole: none before the filters have settled */
    int wait;                  /* samples until they adapt, at the start or again after the limit or the guard acted */
    int missing;               /* samples in a row */
    double level;              /* of slow motion, squared: 1 on the floor of the design */
    ${name}_real floor[$sensors];  /* the last that were there */
    ${name}_real platform[$axes];
    double skyhook[$skyhook_sections][2][$axes];
    double shaping[$shaping_sections][2][$sensors];
    double highpass[$highpass_sections][2][$sensors];
    double integrator[$integrator_sections][2][$both];
    double error[$error_sections][2][$axes];
    double sent[$shaping_sections][2][$axes];
    double past[$kept][$axes]; /* commands, the last one first */
} ${name}_state;

/* Filters at rest, and a warm start: the weights that the design expects, and their covariance on its floor. */
void ${name}_start(${name}_state *s);

/* The same with the weights and the covariance of an earlier run. Returns 0, and starts as above, where they are no
   numbers or no covariance. */
int ${name}_restore(${name}_state *s, const ${name}_real stored[$stored]);

/* What to keep for it. */
void ${name}_store(const ${name}_state *s, ${name}_real stored[$stored]);

/* One sample; returns flags. */
unsigned ${name}_step(${name}_state *s, const ${name}_real floor[$sensors], const ${name}_real platform[$axes],
                    ${name}_real out[$axes]);

#ifdef __cplusplus
}
#endif

#endif
