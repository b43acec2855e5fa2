"""What the C of a motion plans, in closed form: the shortest symmetric move within limits, and what a motion feeds forward.

Lambrechts, Boerlage and Steinbuch, Trajectory planning and feedforward design for electromechanical motion systems, Control
Engineering Practice (2005).
"""

from typing import NamedTuple

import numpy as np

from stillwork.control.setpoint import HALVINGS, _integrated, _knots, _segments


class Move(NamedTuple):
    """From rest to rest; the second half mirrors the first, so that it ends where it should."""

    start: float
    distance: float
    knots: (
        np.ndarray
    )  # of the way up to the largest velocity: time, position and derivatives where each segment begins
    duration: float

    def at(self, t):
        """Position and its first four derivatives, shape (5, times); at rest before and after."""
        t = np.asarray(t)
        moving, back = (t >= 0) & (t < self.duration), t > self.duration / 2
        u = np.where(back, self.duration - t, t)
        places = np.clip(np.searchsorted(self.knots[:, 0], u, side="right") - 1, 0, 7)
        begin, *start, snap = self.knots[places].T
        p, v, a, j = _integrated(u - begin, start, snap)
        mirror = np.where(back, -1.0, 1.0)
        rows = [np.where(back, abs(self.distance) - p, p), v, mirror * a, j, mirror * snap]
        found = np.where(moving, np.copysign(1.0, self.distance) * np.array(rows), 0.0)
        found[0] = self.start + np.where(moving, found[0], np.where(t < 0, 0.0, self.distance))
        return found


def rise_time(limits, top):
    t_snap, t_jerk, t_acceleration, _ = _segments(limits, top)
    return 4 * t_snap + 2 * t_jerk + t_acceleration


def plan_move(distance, limits, start=0.0):
    """The largest velocity that fits, by halving."""
    low, high = 0.0, limits.velocity
    if high * rise_time(limits, high) <= abs(distance):
        low = high
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if middle * rise_time(limits, middle) > abs(distance) else (middle, high)
    if not low or not distance:
        return Move(start, distance, np.zeros((8, 6)), 0.0)
    return Move(start, distance, _knots(limits, low), rise_time(limits, low) + abs(distance) / low)


def run_motion(motion, move, samples, sample_time):
    """Expected position, delayed by the lag, and feedforward force at each sample."""
    time = np.arange(samples) * sample_time
    ahead = move.at(time)
    force = motion.feedforward.gains @ ahead[1:] + motion.feedforward.coulomb * np.sign(ahead[1])
    return np.array([move.at(time - motion.lag)[0], force])
