"""The third-order low pass (7), integrated by Euler's rule."""

from stillwork.base.kernels import borrowing_kernel


@borrowing_kernel
def low_pass_step(options, state, sample_time, measured, estimate):
    """(bandwidth + d/dt)^3 filtered = bandwidth^3 measured; state[0, 0, :3]: filtered and two derivatives.

    The estimate is the state that Euler's step with this measurement reaches. options: bandwidth, whether it starts from
    zero; else it starts with the velocity and acceleration that are presumed, and without a jerk, behind the measurement by
    its own lag. state[0, 0, 3]: 1 once it has started.
    """
    bandwidth = options[0]
    if state[0, 0, 3] == 0.0 and options[1] == 0.0:
        state[0, 0, 1] = estimate[1] - sample_time * estimate[2]
        state[0, 0, 0] = measured - 3.0 * (state[0, 0, 1] + estimate[2] / bandwidth) / bandwidth
        state[0, 0, 2] = estimate[2]
    state[0, 0, 3] = 1.0
    filtered, rate, curvature = state[0, 0, 0], state[0, 0, 1], state[0, 0, 2]
    jerk = bandwidth**3 * (measured - filtered) - 3.0 * bandwidth**2 * rate - 3.0 * bandwidth * curvature
    state[0, 0, 0] = filtered + sample_time * rate
    state[0, 0, 1] = rate + sample_time * curvature
    state[0, 0, 2] = curvature + sample_time * jerk
    estimate[0] = state[0, 0, 0]
    estimate[1] = state[0, 0, 1]
    estimate[2] = state[0, 0, 2]
