"""Tracking under the published designs: with noise (Table 3.7), and of perturbed plants (Table 5.2)."""

MEASURED = 5  # y5, section 3.1
WARM_UP = 3000  # samples in which the noise reaches its steady state
APPLICATIONS = ("MC", "AD", "MC and AD")
# Row and column of Table 5.2, the observer's design and the design that its controller is taken from.
CASES = {"none": ("PID", "PID")}
CASES |= {name: (name, "PID") for name in APPLICATIONS}
CASES |= {f"{name}, redesigned": (name, name) for name in APPLICATIONS}
