/* ${name}_motion: a setpoint of third or fourth order, its feedforward, and the controller of ${name}.h behind them.

   Positions are in $position and double whatever the precision of the controller, which sees the error alone.

       once, with the drive off          t = ${name}_designed;
       to close the loop, also moving    ${name}_enable(&m, &t, position, velocity, force);
       to move, outside of the loop      ${name}_plan(&plan, &t, target - ${name}_rest(&m));
       when it rests                     ${name}_go(&m, &t, &plan);
       each sample                       flags = ${name}_run(&m, &t, measured, &force); */

#ifndef ${guard}_MOTION_H
#define ${guard}_MOTION_H

#include <stdbool.h>
#include <stdint.h>

#include "$name.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ${guard}_KNOTS 8

typedef struct {
    double position;
    double velocity;
    double acceleration;
    double jerk;
    double snap;
} ${name}_point;

/* A move from rest to rest: the way up to its largest velocity, piece by piece; the way down mirrors it. */
typedef struct {
    double begin[${guard}_KNOTS]; /* s */
    ${name}_point knot[${guard}_KNOTS];
    double distance;
    double duration; /* s */
    double force;    /* largest of the feedforward, in sum */
} ${name}_move;

typedef struct {
    ${name}_move plan;
    double from;    /* where the move began */
    double begun;   /* s into the move at sample 0 */
    uint32_t count; /* samples since then */
    ${name}_state loop;
} ${name}_motion;

/* Shortest move over a distance within the limits. Call it outside of the loop: it takes many square roots. False, when
   a limit is not set, or the feedforward would ask for more than the smaller of the output's limits. */
bool ${name}_plan(${name}_move *p, const ${name}_tuning *t, double distance);

/* Close the loop without a bump, at this position and velocity, while this force acts: a setpoint that moves comes to
   rest within the limits. Returns INVALID when a number is missing, or no limits are set and it moves. */
unsigned ${name}_enable(${name}_motion *m, const ${name}_tuning *t, double position, double velocity, ${name}_real force);

/* Begin a move with the next sample. Returns INVALID, and does nothing, while one is under way. */
unsigned ${name}_go(${name}_motion *m, const ${name}_tuning *t, const ${name}_move *p);

/* Where the setpoint rests, or will. */
double ${name}_rest(const ${name}_motion *m);

/* One sample. A measurement that is missing is NaN. Returns flags, MOVING while a move is under way. */
unsigned ${name}_run(${name}_motion *m, const ${name}_tuning *t, double measured, ${name}_real *force);

#ifdef __cplusplus
}
#endif

#endif
