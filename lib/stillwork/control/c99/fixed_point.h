/* $title

   Write the functions of the model that are declared below; then call ${name}_start once and ${name}_step each sample.
   Nothing is allocated, and several may run side by side. */

#ifndef ${guard}_H
#define ${guard}_H

#ifdef __cplusplus
extern "C" {
#endif

#define ${guard}_COORDINATES $count
#define ${guard}_GAINS $gains
#define ${guard}_PARAMETERS $parameters
#define ${guard}_SAMPLE_TIME $sample_time /* s */

/* Flags of a sample; 0: none. */
#define ${guard}_LIMITED 1u /* a force is at its limit */
#define ${guard}_LOST 2u    /* a measurement is missing, not a number */
#define ${guard}_INVALID 4u /* nothing could be calculated: force and states stay as they were */

typedef $real ${name}_real;

/* What may be tuned between two samples; ${name}_designed is what was computed. */
typedef struct {
    ${name}_real gain[$count][$gains];       /* of the integrals, deepest first, of the error and of its derivative */
    int robust[$count];                      /* 0: transformation (6) with A, w; 1: (8) with K, B, A */
    ${name}_real transformation[$count][3];
    ${name}_real force_limit[$count];
    ${name}_real model[$parameters];         /* parameters of the model */
l|    ${name}_real bandwidth[$count];          /* of the low passes, rad/s */
k|    ${name}_real process[$count][$states][$states]; /* Q of the filters, by velocity, position$disturbance */
k|    ${name}_real noise[$count][$outputs][$outputs]; /* R */
b|    ${name}_real believed[$believed];        /* parameters of the filter's model */
} ${name}_tuning;

extern const ${name}_tuning ${name}_designed;

typedef struct {
    ${name}_real estimate[$count][3]; /* position, velocity and acceleration */
    ${name}_real integral[$count][$chain];
    ${name}_real deformed[$count];
    ${name}_real measured[$count]; /* or what stood for it */
    ${name}_real push[$count];     /* that acted on the filters */
    ${name}_real force[$count];
    int held[$count];
    int samples; /* 0 before the first, then 1 */
w|    ${name}_real window[$count][3][$window]; /* oldest first */
l|    ${name}_real low_pass[$count][3];
k|    ${name}_real mean[$count][$states];
k|    ${name}_real covariance[$count][$states][$states];
u|    ${name}_real past[$count]; /* the last measurement */
u|    int missing[$count];
} ${name}_state;

/* To be written: forces of the model that give an acceleration, and accelerations that forces give. */
void ${name}_model_force(const ${name}_real position[$count], const ${name}_real velocity[$count],
                         const ${name}_real acceleration[$count], const ${name}_real model[$parameters],
                         ${name}_real force[$count]);
void ${name}_model_acceleration(const ${name}_real position[$count], const ${name}_real velocity[$count],
                                const ${name}_real force[$count], const ${name}_real model[$parameters],
                                ${name}_real acceleration[$count]);
b|/* To be written: acceleration of the filter's model. */
b|${name}_real ${name}_believed_acceleration(${name}_real position, ${name}_real velocity, ${name}_real force,
b|                                           const ${name}_real believed[$believed]);

/* Begin with the positions and velocities that the filters presume before the first sample. */
void ${name}_start(${name}_state *s, const ${name}_real position[$count], const ${name}_real velocity[$count]);

/* One sample: wanted position, velocity and acceleration of each coordinate, and what is measured; NaN is a lost sample,
   but not in the first. Returns flags. */
unsigned ${name}_step(${name}_state *s, const ${name}_tuning *t, ${name}_real nominal[3][$count],
                      const ${name}_real measured[$count], ${name}_real force[$count]);

#ifdef __cplusplus
}
#endif

#endif
