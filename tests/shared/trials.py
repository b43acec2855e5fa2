"""Trials for studies; in a module of their own, so that other processes can import them."""


def draw(rng, mean=0.0, size=3):
    return {"level": rng.normal(mean), "path": rng.normal(size=size)}


def failing(rng):
    raise ValueError("no convergence")
