/* $title

   The axes' own controllers are in the folders beside this file; compile their sources, too. Nothing is allocated. */

#ifndef ${guard}_H
#define ${guard}_H

$includes
#ifdef __cplusplus
extern "C" {
#endif

#define ${guard}_SENSORS $sensors
#define ${guard}_AXES $axes
#define ${guard}_ACTUATORS $actuators

typedef $real ${name}_real;

/* A struct of zeros is a controller whose states are zero. */
typedef struct {
$fields} ${name}_state;

/* From the sensors to the axes, q = T_y y, and from the axes to the actuators, u = T_u f: for axes that have a setpoint
   and a feedforward of their own, run between the two. */
void ${name}_sense(const ${name}_real y[$sensors], ${name}_real q[$axes]);
void ${name}_actuate(const ${name}_real f[$axes], ${name}_real u[$actuators]);

/* One sample without them: from the setpoint less the measurement of each sensor to the output of each actuator.
   Returns the flags of all axes.
$signals*/
unsigned ${name}_step(${name}_state *s, const ${name}_real error[$sensors], ${name}_real out[$actuators]);

#ifdef __cplusplus
}
#endif

#endif
