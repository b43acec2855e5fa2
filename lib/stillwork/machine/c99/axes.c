#include "$name.h"

void ${name}_sense(const ${name}_real y[$sensors], ${name}_real q[$axes])
{
$sense}

void ${name}_actuate(const ${name}_real f[$axes], ${name}_real u[$actuators])
{
$actuate}

unsigned ${name}_step(${name}_state *s, const ${name}_real error[$sensors], ${name}_real out[$actuators])
{
    const ${name}_real known[1] = {$zero};
    ${name}_real q[$axes];
    ${name}_real f[$axes];
    unsigned flags = 0u;

    ${name}_sense(error, q);
$steps    ${name}_actuate(f, out);
    return flags;
}
