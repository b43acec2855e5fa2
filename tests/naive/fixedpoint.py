"""Slow, obvious twins of the fixedpoint topic's kernels: matrices, polynomial fits, plain loops."""

import numpy as np


def oscillator(parameters, position, velocity, force):
    """(11) solved for the acceleration."""
    m, k, a, b1, b2, d = parameters
    drag = d * np.sign(velocity) * velocity**2
    return (force - k * position + b1 * (a**2 - position**2) * velocity - b2 * velocity - drag) / m


def oscillator_force(parameters, position, velocity, acceleration):
    """(11) as it is printed."""
    m, k, a, b1, b2, d = parameters
    drag = d * np.sign(velocity) * velocity**2
    return m * acceleration + k * position - b1 * (a**2 - position**2) * velocity + b2 * velocity + drag


def sigmoid(x):
    return x / (1 + abs(x))


def flow(gain, width):
    """(6)."""
    return lambda previous, response, desired: previous + gain * sigmoid((response - desired) / width)


def robust(offset, factor, slope):
    """(8), as it is printed."""
    return lambda previous, response, desired: (
        (previous + offset) * (1 + factor * sigmoid(slope * (response - desired))) - offset
    )


class MovingWindow:
    """Three cascaded straight-line fits by polyfit, with lists that forget."""

    def __init__(self, length, sample_time):
        self.samples, self.sample_time, self.lists = length + 1, sample_time, None

    def __call__(self, measured, _force, presumed):
        if self.lists is None:
            ramp = [measured - presumed[1] * self.sample_time * back for back in range(self.samples, 0, -1)]
            self.lists = [ramp, [presumed[1]] * self.samples, [presumed[2]] * self.samples]
            self.last = [measured - presumed[1] * self.sample_time, presumed[1], presumed[2]]
        value, out = measured, []
        for level in range(3):
            self.lists[level] = [*self.lists[level][1:], value]
            slope, base = np.polyfit(np.arange(self.samples), self.lists[level], 1)
            fitted = slope * (self.samples - 1) + base
            value = (fitted - self.last[level]) / self.sample_time
            self.last[level] = fitted
            out.append(fitted)
        return np.array(out)


class SavitzkyGolay:
    """A polynomial fit by polyfit, and its derivatives by polyder."""

    def __init__(self, samples, degree, sample_time):
        self.samples, self.degree, self.sample_time, self.window = samples, degree, sample_time, None

    def __call__(self, measured, _force, presumed):
        if self.window is None:
            self.window = [measured - presumed[1] * self.sample_time * b for b in range(self.samples, 0, -1)]
        self.window = [*self.window[1:], measured]
        time = np.arange(1 - self.samples, 1) * self.sample_time
        fit = np.polynomial.Polynomial.fit(time, self.window, self.degree)
        return np.array([fit(0.0), fit.deriv(1)(0.0), fit.deriv(2)(0.0)])


class LowPass:
    """(7) in companion form, Euler's rule; `past`: so many samples of what is presumed went through it, else it starts at zero."""

    def __init__(self, bandwidth, sample_time, past=0):
        w = bandwidth
        self.A = np.array([[0, 1, 0], [0, 0, 1], [-(w**3), -3 * w**2, -3 * w]])
        self.B = np.array([0, 0, w**3])
        self.x, self.sample_time, self.past = np.zeros(3), sample_time, past

    def __call__(self, measured, _force, presumed):
        for time in -self.sample_time * np.arange(self.past, 0, -1):
            self.past = 0
            self(measured + presumed[1] * time + presumed[2] * time**2 / 2, 0.0, presumed)
        self.x = self.x + self.sample_time * (self.A @ self.x + self.B * measured)
        return self.x


def unscented_transform(points, mean_weights, covariance_weights):
    mean = mean_weights @ points
    return mean, (points - mean).T @ np.diag(covariance_weights) @ (points - mean)


def unscented_weights(size, alpha, beta, kappa):
    lam = alpha**2 * (size + kappa) - size
    mean = np.full(2 * size + 1, 1 / (2 * (size + lam)))
    covariance = mean.copy()
    mean[0] = lam / (size + lam)
    covariance[0] = mean[0] + 1 - alpha**2 + beta
    return size + lam, mean, covariance


def sigma_points(mean, covariance, spread):
    root = np.linalg.cholesky(spread * covariance)
    return np.vstack([mean, mean + root.T, mean - root.T])


def unscented_step(x, P, z, f, h, Q, R, alpha, beta, kappa, literal=False):
    """(12)-(17); `literal` keeps the points of the previous estimate for the correction, (14) as printed."""
    spread, wm, wc = unscented_weights(len(x), alpha, beta, kappa)
    drawn = sigma_points(x, P, spread)
    predicted, covariance = unscented_transform(np.array([f(point) for point in drawn]), wm, wc)
    covariance = covariance + Q
    if not literal:
        drawn = sigma_points(predicted, covariance, spread)
    seen = np.array([h(point) for point in drawn])
    expected, innovation = unscented_transform(seen, wm, wc)
    innovation = innovation + R
    cross = (drawn - predicted).T @ np.diag(wc) @ (seen - expected)
    gain = cross @ np.linalg.inv(innovation)
    return predicted + gain @ (z - expected), covariance - gain @ innovation @ gain.T


def kalman_step(x, P, z, predicted, F, H, expected, Q, R):
    """Textbook (extended) Kalman filter, Joseph's form."""
    prior = F @ P @ F.T + Q
    gain = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + R)
    left = np.eye(len(x)) - gain @ H
    return predicted + gain @ (z - expected), left @ prior @ left.T + gain @ R @ gain.T


class PlantUnscented:
    def __init__(self, parameters, Q, R, initial_variance, sample_time, literal=False):
        self.parameters, self.Q, self.R, self.sample_time = parameters, Q, R, sample_time
        self.P, self.x, self.literal = initial_variance * np.eye(2), None, literal

    def __call__(self, measured, force, presumed):
        sample_time = self.sample_time
        if self.x is None:
            self.past = measured - sample_time * presumed[1]
            self.x = np.array([presumed[1], self.past])

        def move(x):
            velocity = x[0] + sample_time * oscillator(self.parameters, x[1], x[0], force)
            return np.array([velocity, x[1] + sample_time * velocity])

        z = np.array([(measured - self.past) / sample_time, measured])
        before = self.x[0]
        self.x, self.P = unscented_step(
            self.x, self.P, z, move, lambda x: x, self.Q, self.R, 1e-2, 1e-3, 0.0, self.literal
        )
        self.past = measured
        return np.array([self.x[1], self.x[0], (self.x[0] - before) / sample_time])


def closed_loop(
    device,
    transformation,
    gains,
    error_from_measurement,
    exact,
    approximate,
    nominal,
    noise,
    sample_time,
    semi_implicit=True,
    resolution=0.0,
):
    """Fig. 1, one sample after another; returns rows of position, velocity, acceleration, deformed, force."""
    q, v = nominal[0][0], nominal[1][0]
    presumed = np.array([q, v, nominal[2][0]])
    integrals = np.zeros(len(gains) - 2)
    force, deformed, rows = 0.0, None, []
    for qn, vn, an, n in zip(*nominal, noise, strict=True):
        measured = q + n
        if resolution:
            measured = resolution * np.round(measured / resolution)
        estimate = device(measured, force, presumed)
        seen = measured if error_from_measurement else estimate[0]
        chain = [qn - seen]
        for j in range(len(integrals)):
            integrals[j] += sample_time * chain[-1]
            chain.append(integrals[j])
        desired = an + gains[-1] * (vn - estimate[1]) + np.dot(gains[:-1], chain[::-1])
        deformed = desired if deformed is None else transformation(deformed, estimate[2], desired)
        force = oscillator_force(approximate, seen, estimate[1], deformed)
        acceleration = oscillator(exact, q, v, force)
        rows.append([q, v, acceleration, deformed, force])
        before = v
        v = v + sample_time * acceleration
        q = q + sample_time * (v if semi_implicit else before)
    return np.array(rows).T


def loop_of_coordinates(exact, approximate, gains, nominal, noise, sample_time, answer):
    """Fig. 1 with vectors, a low pass on every coordinate; rows of position and force of all.

    `answer(desired, response)` is the next command, after what the filters say of the last one.
    """
    devices = [LowPass(350.0, sample_time, past=1000) for _ in noise]
    presumed = [each[0] for each in nominal]
    q, v, integral = np.full(len(noise), presumed[0]), np.full(len(noise), presumed[1]), np.zeros(len(noise))
    rows = []
    for qn, vn, an, n in zip(*nominal, noise.T, strict=True):
        measured = q + n
        filtered = np.array([device(z, 0.0, presumed) for device, z in zip(devices, measured, strict=True)])
        integral = integral + sample_time * (qn - measured)
        desired = an + gains @ [integral, qn - measured, vn - filtered[:, 1]]
        force = approximate.force(measured, filtered[:, 1], answer(desired, filtered[:, 2]))
        rows.append([q, force])
        v = v + sample_time * exact.acceleration(q, v, force)
        q = q + sample_time * v
    return np.array(rows).transpose(1, 2, 0)
