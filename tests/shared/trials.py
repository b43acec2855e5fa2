"""Trials for studies."""


def draw(rng, mean=0.0, size=3):
    return {"level": rng.normal(mean), "path": rng.normal(size=size)}


def failing(rng):
    raise ValueError("no convergence")
