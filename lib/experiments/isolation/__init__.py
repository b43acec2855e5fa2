"""Isolation: the rig that holds still by self-tuned feedforward, its twins, studies and pictures.

A run in four lines::

    import numpy as np
    from experiments.isolation import flat_floor, load_twin, simulate, steady_state
    from stillwork.estimation import FeRls

    twin = load_twin("rigid_body")                  # or "fitted", or the path of a TOML file of the same form
    floor = flat_floor(80.0)                        # or coloured_floor()
    steady = steady_state(twin, floor)              # optimum weights and covariance, in the frequency domain
    run = simulate(twin, floor, 100.0, adaptation=FeRls(10 * np.diag(steady.covariance)), seed=1)

The four cases of the paper are ``simulate(..., feedback=False)``, ``simulate(...)``,
``simulate(..., weights=W)`` and ``simulate(..., adaptation=FeLms() or FeRls(...))``; ``signals_from_s=20.0``
keeps a0, a1, u, psi_N and e at the full rate from there on; ``[(100.0, flat), (100.0, coloured)]`` in place of
the floor changes it in mid-run; ``twin.varied(platform_noise=1e-5)`` is another twin.
"""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "floors": ("ShapedFloor", "coloured_floor", "flat_floor"),
        "recorded_floors": ("RecordedFloor",),
        "rig": ("Lines", "Rig"),
        "simulation": ("Run", "simulate", "simulate_together"),
        "steady": ("steady_state",),
        "twin": ("Twin", "load_twin", "twin_from_table"),
    },
)
