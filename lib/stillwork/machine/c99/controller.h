/* $title

   $signals

   Call ${name}_start once, then ${name}_step each sample. Nothing is allocated, and several may run side by side.
   A struct of zeros is a controller whose states are zero. */

#ifndef ${guard}_H
#define ${guard}_H

#ifdef __cplusplus
extern "C" {
#endif

#define ${guard}_INPUTS $inputs
#define ${guard}_OUTPUTS $outputs
x|#define ${guard}_STATES $states
#define ${guard}_SAMPLE_TIME $sample_time /* s */

/* Flags of a sample; 0: none. */
#define ${guard}_SATURATED 1u /* a limit acts */
#define ${guard}_HELD 2u      /* an input is missing, not a number: the last one stands for it */
#define ${guard}_INVALID 4u   /* missing for too long, or out of range: output and states stay as they were */
m|#define ${guard}_MOVING 8u    /* the setpoint is under way */

typedef $real ${name}_real;

/* What may be tuned between two samples; ${name}_designed is what the design promises something of. */
typedef struct {
    ${name}_real gain[$inputs]; /* of each input: the gain of the loop */
    ${name}_real low[$outputs]; /* limits of each output */
    ${name}_real high[$outputs];
    int patience; /* samples in a row for which a missing input is held */
m|    ${name}_real feed_velocity; /* $force/($position/s) */
m|    ${name}_real feed_acceleration; /* $force/($position/s^2) */
m|    ${name}_real feed_jerk; /* $force/($position/s^3) */
m|    ${name}_real feed_snap; /* $force/($position/s^4) */
m|    ${name}_real feed_coulomb; /* $force, in the direction of the motion */
m|    double lag; /* s, of the position behind the feedforward */
m|    double limit_velocity; /* $position/s, of the setpoint */
m|    double limit_acceleration; /* $position/s^2 */
m|    double limit_jerk; /* $position/s^3 */
m|    double limit_snap; /* $position/s^4; 0: moves of third order */
} ${name}_tuning;

extern const ${name}_tuning ${name}_designed;

typedef struct {
x|    ${name}_real state[$states];
x|    ${name}_real rest[$states]; /* what rounding has left of each state */
    ${name}_real in[$inputs]; /* the last that were there */
    ${name}_real known[$outputs];
    ${name}_real out[$outputs]; /* the last that were given */
    int missing; /* samples in a row */
d|    ${name}_real ring[$delay][$outputs]; /* on its way out */
d|    int place;
} ${name}_state;

/* Take over without a bump: the next step with these inputs gives these outputs, and where the controller has such a
   rest it keeps them. Call it before the first step, and whenever control is taken up again. `known` is what is fed
   forward, zeros where nothing is. Returns INVALID, and leaves the states alone, when a number is missing. */
unsigned ${name}_start(${name}_state *s, const ${name}_tuning *t, const ${name}_real in[$inputs],
                    const ${name}_real known[$outputs], const ${name}_real out[$outputs]);

/* One sample: from what was measured to what acts until the next one$late. `known` is part of `out`: the inputs are
   deviations from the motion that it makes. Returns flags. */
unsigned ${name}_step(${name}_state *s, const ${name}_tuning *t, const ${name}_real in[$inputs],
                    const ${name}_real known[$outputs], ${name}_real out[$outputs]);

#ifdef __cplusplus
}
#endif

#endif
