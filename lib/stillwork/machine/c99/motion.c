#include "${name}_motion.h"

#include <math.h>

typedef ${name}_point point;

/* Lengths of the pieces of constant snap, jerk and acceleration on the way from rest to the velocity `top`, and the jerk
   that is reached. Returns the time that the way takes. */
static double pieces(const ${name}_tuning *t, double top, double length[3], double *jerk)
{
    double snapping = 0.0;
    double jerking;
    double accelerating;
    double by_acceleration;
    double by_velocity;
    double peak;

    *jerk = t->limit_jerk;
    if (t->limit_snap > 0.0) {
        snapping = fmin(sqrt(t->limit_acceleration / t->limit_snap), cbrt(top / (2.0 * t->limit_snap)));
        snapping = fmin(t->limit_jerk / t->limit_snap, snapping);
        *jerk = t->limit_snap * snapping;
    }
    by_acceleration = (t->limit_acceleration / *jerk) - snapping;
    by_velocity = (sqrt((snapping * snapping) + (4.0 * top / *jerk)) - (3.0 * snapping)) / 2.0;
    jerking = fmax(fmin(by_acceleration, by_velocity), 0.0);
    peak = *jerk * (snapping + jerking);
    accelerating = fmax((top / peak) - (2.0 * snapping) - jerking, 0.0);
    length[0] = snapping;
    length[1] = jerking;
    length[2] = accelerating;
    return (4.0 * snapping) + (2.0 * jerking) + accelerating;
}

/* Where constant snap leads within a time. */
static point follow(const point *from, double u)
{
    point to = *from;

    to.position += u * (from->velocity + (u * ((from->acceleration / 2.0)
                   + (u * ((from->jerk / 6.0) + (u * from->snap / 24.0))))));
    to.velocity += u * (from->acceleration + (u * ((from->jerk / 2.0) + (u * from->snap / 6.0))));
    to.acceleration += u * (from->jerk + (u * from->snap / 2.0));
    to.jerk += u * from->snap;
    return to;
}

/* Fill in the way up to the velocity `top`, 0 for none; returns the time that it takes. */
static double rise(${name}_move *p, const ${name}_tuning *t, double top)
{
    static const int piece[${guard}_KNOTS - 1] = {0, 1, 0, 2, 0, 1, 0};
    static const double jerks[${guard}_KNOTS] = {0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0};
    static const double snaps[${guard}_KNOTS] = {1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0, 0.0};
    const point rest = {0.0, 0.0, 0.0, 0.0, 0.0};
    double length[3] = {0.0, 0.0, 0.0};
    double jerk = 0.0;
    double time = 0.0;
    double reached;
    int k;

    p->begin[0] = 0.0;
    p->knot[0] = rest;
    if (top > 0.0) {
        time = pieces(t, top, length, &jerk);
    }
    for (k = 0; k < ${guard}_KNOTS; k++) {
        p->knot[k].jerk = jerk * jerks[k];
        p->knot[k].snap = (top > 0.0) ? (t->limit_snap * snaps[k]) : 0.0;
        if (k < (${guard}_KNOTS - 1)) {
            p->begin[k + 1] = p->begin[k] + length[piece[k]];
            p->knot[k + 1] = follow(&p->knot[k], length[piece[k]]);
        }
    }
    reached = p->knot[3].acceleration;
    p->knot[${guard}_KNOTS - 1].acceleration = 0.0;
    p->force = fabs((double)t->feed_velocity * top) + (double)t->feed_coulomb
        + fabs((double)t->feed_acceleration * reached) + fabs((double)t->feed_jerk * jerk)
        + fabs((double)t->feed_snap * p->knot[0].snap);
    return time;
}

static bool has_limits(const ${name}_tuning *t)
{
    return (t->limit_velocity > 0.0) && (t->limit_acceleration > 0.0) && (t->limit_jerk > 0.0)
        && (t->limit_snap >= 0.0);
}

bool ${name}_plan(${name}_move *p, const ${name}_tuning *t, double distance)
{
    const double way = fabs(distance);
    bool possible = has_limits(t) && (isfinite(distance) != 0);

    if (possible) {
        double low = 0.0;
        double high = t->limit_velocity;
        double length[3];
        double jerk;
        int i;

        if ((high * pieces(t, high, length, &jerk)) > way) { /* too short for it: halve where its velocity lies */
            for (i = 0; i < $halvings; i++) {
                const double middle = (low + high) / 2.0;

                if ((middle * pieces(t, middle, length, &jerk)) > way) {
                    high = middle;
                } else {
                    low = middle;
                }
            }
        } else {
            low = high;
        }
        if (way <= 0.0) {
            low = 0.0;
        }
        p->distance = distance;
        p->duration = rise(p, t, low);
        if (low > 0.0) {
            p->duration += way / low;
        }
        possible = p->force <= fmin((double)t->high[0], -(double)t->low[0]);
    }
    return possible;
}

/* Of a move, or of rest before and after it. */
static point look(const ${name}_move *p, double time)
{
    const bool back = time > (p->duration / 2.0);
    const double sign = (p->distance < 0.0) ? -1.0 : 1.0;
    const double mirror = back ? -sign : sign;
    double u = back ? (p->duration - time) : time;
    point at = {0.0, 0.0, 0.0, 0.0, 0.0};

    if ((time >= 0.0) && (time < p->duration)) {
        int k = 0;

        while ((k < (${guard}_KNOTS - 1)) && (u >= p->begin[k + 1])) {
            k++;
        }
        at = follow(&p->knot[k], u - p->begin[k]);
        at.position = back ? (p->distance - (sign * at.position)) : (sign * at.position);
        at.velocity *= sign;
        at.acceleration *= mirror;
        at.jerk *= sign;
        at.snap *= mirror;
    } else if (time >= 0.0) {
        at.position = p->distance;
    } else {
        at.position = 0.0;
    }
    return at;
}

static ${name}_real feedforward(const ${name}_tuning *t, const point *at)
{
    ${name}_real force = t->feed_velocity * (${name}_real)at->velocity;

    force += t->feed_acceleration * (${name}_real)at->acceleration;
    force += t->feed_jerk * (${name}_real)at->jerk;
    force += t->feed_snap * (${name}_real)at->snap;

    if (at->velocity > 0.0) {
        force += t->feed_coulomb;
    }
    if (at->velocity < 0.0) {
        force -= t->feed_coulomb;
    }
    return force;
}

static double now(const ${name}_motion *m)
{
    return m->begun + ((double)m->count * ${guard}_SAMPLE_TIME);
}

unsigned ${name}_enable(${name}_motion *m, const ${name}_tuning *t, double position, double velocity, ${name}_real force)
{
    const ${name}_real none[1] = {$zero};
    unsigned flags = ${guard}_INVALID;

    if ((isfinite(position) != 0) && (isfinite(velocity) != 0) && (isfinite(force) != 0)
        && (has_limits(t) || (fabs(velocity) <= 0.0))) {
        /* The second half of a move that has its largest velocity here. */
        const double time = rise(&m->plan, t, fabs(velocity));
        ${name}_real known[1];
        point at;

        m->plan.distance = velocity * time;
        m->plan.duration = 2.0 * time;
        m->from = position - (m->plan.distance / 2.0);
        m->begun = time + t->lag;
        m->count = 0u;
        at = look(&m->plan, m->begun);
        known[0] = feedforward(t, &at);
        flags = ${name}_start(&m->loop, t, none, known, &force);
    }
    return flags;
}

unsigned ${name}_go(${name}_motion *m, const ${name}_tuning *t, const ${name}_move *p)
{
    unsigned flags = ${guard}_INVALID;

    if ((now(m) - t->lag) >= m->plan.duration) {
        m->from += m->plan.distance;
        m->plan = *p;
        m->begun = 0.0;
        m->count = 0u;
        flags = 0u;
    }
    return flags;
}

double ${name}_rest(const ${name}_motion *m)
{
    return m->from + m->plan.distance;
}

unsigned ${name}_run(${name}_motion *m, const ${name}_tuning *t, double measured, ${name}_real *force)
{
    const double time = now(m);
    const point ahead = look(&m->plan, time);
    const point late = look(&m->plan, time - t->lag);
    const ${name}_real error[1] = {(${name}_real)((m->from + late.position) - measured)};
    const ${name}_real known[1] = {feedforward(t, &ahead)};
    unsigned flags = ${name}_step(&m->loop, t, error, known, force);

    if ((time - t->lag) < m->plan.duration) {
        m->count++;
        flags |= ${guard}_MOVING;
    }
    return flags;
}
