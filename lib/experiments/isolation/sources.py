"""Floor motion and sensor noise of runs side by side, drawn block by block."""

import numpy as np

from experiments.isolation import loop
from experiments.isolation.floors import ShapedFloor
from experiments.isolation.recorded_floors import RecordedFloor
from experiments.isolation.twin import Twin
from stillwork.base.kernels import kernel

BLOCK = 4096  # most samples drawn at a time: small enough for the cache, large enough to forget the call

Floor = ShapedFloor | RecordedFloor


class Sources:
    """Floor motion and sensor noise, block by block, each of every run from a random stream of its own.

    Channel c of run r stands at c * runs + r; the last seed's run stands in every place that is left over.
    """

    def __init__(
        self, twin: Twin, segments: list[tuple[int, Floor]], noise: bool, seeds: list[int], runs: int = 1
    ):
        streams = [np.random.SeedSequence(seed).spawn(2) for seed in seeds]
        self.floor_streams, self.noise_streams = (
            [np.random.Generator(np.random.SFC64(s)) for s in each] for each in zip(*streams, strict=True)
        )
        self.runs, self.together = runs, None if runs == 1 else (0,) * runs
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
        self.room = np.empty((len(seeds), BLOCK * len(self.deviation)))
        self.segments = list(segments)
        self.done = 0
        self._enter()

    def _enter(self):
        self.left, self.part = self.segments.pop(0)
        self.position = 0
        if isinstance(self.part, ShapedFloor):
            each = np.moveaxis(self.part.sections, 0, -1)
            self.shaping = loop.bank_of(each, self.sensors * self.runs)

    def sample(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Next block of a0, (samples, sensors * runs), and of (n1, n0), (samples, (outputs + sensors) * runs)."""
        floor = np.empty((samples, self.sensors * self.runs))
        filled = 0
        while filled < samples:
            if not self.left:
                self._enter()
            take = min(samples - filled, self.left)
            self._fill(floor[filled : filled + take])
            filled += take
            self.left -= take
            self.position += take
        noise = np.zeros((samples, len(self.deviation) * self.runs))
        if self.deviation.any() or self.mains.any():
            start = (self.omega * self.done)[:, None]
            hum = self.waves[:samples] @ np.vstack([np.cos(start) * self.mains, np.sin(start) * self.mains])
            _interleave(self._sample(self.noise_streams, hum.shape), self.deviation, hum, noise)
        self.done += samples
        return floor, noise

    def _fill(self, floor):
        if isinstance(self.part, RecordedFloor):
            record = self.part.acceleration[:, self.position : self.position + len(floor)].T
            floor[:] = np.repeat(record, self.runs, axis=1)
            return
        nothing = np.zeros((len(floor), self.sensors))
        _interleave(self._sample(self.floor_streams, nothing.shape), self.part.scale, nothing, floor)
        loop.filter_block(self.shaping, floor, self.together)

    def _sample(self, streams: list[np.random.Generator], shape: tuple[int, int]) -> np.ndarray:
        """White noise of variance 1, (runs, samples, channels), until the next call: fresh memory would cost as much."""
        size = shape[0] * shape[1]
        for stream, room in zip(streams, self.room, strict=True):
            stream.standard_normal(out=room[:size])
        return self.room[:, :size].reshape(-1, *shape)


@kernel
def _interleave(drawn, scale, added, out):
    """The runs of `drawn` side by side, each channel times its `scale`, with what is `added` to all of them."""
    runs = out.shape[1] // len(scale)
    for k in range(len(out)):
        for c in range(len(scale)):
            for run in range(runs):
                out[k, c * runs + run] = drawn[min(run, len(drawn) - 1), k, c] * scale[c] + added[k, c]
