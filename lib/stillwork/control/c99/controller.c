#include "$name.h"

#ifdef __FAST_MATH__
#error "the compensated sums need IEEE arithmetic: compile without -ffast-math"
#endif

typedef ${name}_real real;
$helpers
void ${name}_start(${name}_state *s, const real in[$inputs], const real out[$outputs])
{
    real f[$outputs];
    int i;

    (void)in;
$clipped
    for (i = 0; i < $states; i++)
        s->rest[i] = 0;
$start$fill}

void ${name}_step(${name}_state *s, const real in[$inputs], real out[$outputs])
{
    const real *x = s->state;
    real f[$outputs], d[$states];$excess

$commands
$changes
$moves$give}
