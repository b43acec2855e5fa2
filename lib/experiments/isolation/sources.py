"""Floor motion and sensor noise of a run, drawn block by block."""

import numpy as np

from experiments.isolation import loop
from experiments.isolation.floors import ShapedFloor
from experiments.isolation.recorded_floors import RecordedFloor
from experiments.isolation.twin import Twin

BLOCK = 4096  # most samples drawn at a time: small enough for the cache, large enough to forget the call

Floor = ShapedFloor | RecordedFloor


class Sources:
    """Floor motion and sensor noise, block by block, each from its own random stream."""

    def __init__(self, twin: Twin, segments: list[tuple[int, Floor]], noise: bool, seed: int):
        streams = np.random.SeedSequence(seed).spawn(2)
        self.floor_stream, self.noise_stream = (np.random.Generator(np.random.SFC64(s)) for s in streams)
        instruments = twin.instruments
        self.rate = instruments.sample_rate
        each = [twin.outputs, twin.sensors]
        density = np.repeat([instruments.platform_noise, instruments.floor_noise], each)
        self.deviation = noise * density * np.sqrt(self.rate / 2)
        self.mains = noise * np.repeat([instruments.platform_mains, instruments.floor_mains], each, axis=0).T
        # Sines of a block by addition theorem: one table for all blocks.
        self.omega = 2 * np.pi * np.asarray(instruments.mains_hz) / self.rate
        angle = np.outer(np.arange(BLOCK), self.omega)
        self.waves = np.hstack([np.sin(angle), np.cos(angle)])
        self.sensors = twin.sensors
        self.segments = list(segments)
        self.done = 0
        self._enter()

    def _enter(self):
        self.left, self.part = self.segments.pop(0)
        self.position = 0
        if isinstance(self.part, ShapedFloor):
            rows = np.stack([loop.rows_of(each) for each in self.part.sections], axis=2)
            self.shaping = loop.bank_of(rows, self.sensors)

    def sample(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Next block of a0, (samples, sensors), and of (n1, n0), (samples, outputs + sensors)."""
        floor = np.empty((samples, self.sensors))
        filled = 0
        while filled < samples:
            if not self.left:
                self._enter()
            take = min(samples - filled, self.left)
            self._fill(floor[filled : filled + take])
            filled += take
            self.left -= take
            self.position += take
        noise = np.zeros((samples, len(self.deviation)))
        if self.deviation.any():
            self.noise_stream.standard_normal(out=noise)
            noise *= self.deviation
        if self.mains.any():
            start = (self.omega * self.done)[:, None]
            noise += self.waves[:samples] @ np.vstack(
                [np.cos(start) * self.mains, np.sin(start) * self.mains]
            )
        self.done += samples
        return floor, noise

    def _fill(self, floor):
        if isinstance(self.part, RecordedFloor):
            floor[:] = self.part.acceleration[:, self.position : self.position + len(floor)].T
            return
        self.floor_stream.standard_normal(out=floor)
        floor *= self.part.scale
        loop.filter_block(*self.shaping, floor)


class Together:
    """Sources of several runs, channel after channel, each once a run."""

    def __init__(self, twin: Twin, segments, noise: bool, seeds: list[int], runs: int):
        self.each = [Sources(twin, segments, noise, seed) for seed in seeds]
        self.runs = runs

    def sample(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """As `Sources.sample`; the last seed's stands in every place that is left over."""
        if self.runs == 1:
            return self.each[0].sample(samples)
        found = [source.sample(samples) for source in self.each]
        found += found[-1:] * (self.runs - len(found))
        return tuple(np.stack(part, axis=-1).reshape(samples, -1) for part in zip(*found, strict=True))
