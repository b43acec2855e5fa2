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

    The last seed's run fills the places that are left over.
    """

    def __init__(
        self, twin: Twin, segments: list[tuple[int, Floor]], noise: bool, seeds: list[int], runs: int = 1
    ):
        streams = [np.random.SeedSequence(seed).spawn(2) for seed in seeds]
        self.floor_streams, self.noise_streams = (
            [np.random.Generator(np.random.SFC64(s)) for s in each] for each in zip(*streams, strict=True)
        )
        self.runs = runs
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
        self.outputs, self.sensors = twin.outputs, twin.sensors
        self.room = np.empty((len(seeds), BLOCK * len(self.deviation)))
        self.segments = list(segments)
        self.done = 0
        self._enter()

    def _enter(self):
        self.left, self.part = self.segments.pop(0)
        self.position = 0
        if isinstance(self.part, ShapedFloor):
            each = np.moveaxis(self.part.sections, 0, -1)
            self.shaping = loop.bank_of(np.tile(each, self.runs), self.sensors * self.runs)

    def sample(self, samples: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Next block of a0, (samples, runs, sensors), and of n1 and n0, (samples, runs, outputs or sensors)."""
        floor = np.empty((samples, self.runs, self.sensors))
        filled = 0
        while filled < samples:
            if not self.left:
                self._enter()
            take = min(samples - filled, self.left)
            self._fill(floor[filled : filled + take])
            filled += take
            self.left -= take
            self.position += take
        noise = tuple(np.zeros((samples, self.runs, count)) for count in (self.outputs, self.sensors))
        if self.deviation.any() or self.mains.any():
            start = (self.omega * self.done)[:, None]
            hum = self.waves[:samples] @ np.vstack([np.cos(start) * self.mains, np.sin(start) * self.mains])
            _put(self._sample(self.noise_streams, hum.shape), self.deviation, hum, *noise)
        self.done += samples
        return floor, noise

    def _fill(self, floor):
        if isinstance(self.part, RecordedFloor):
            record = self.part.acceleration[:, self.position : self.position + len(floor)].T
            floor[:] = record[:, None]
            return
        nothing = np.zeros((len(floor), self.sensors))
        _put(
            self._sample(self.floor_streams, nothing.shape),
            self.part.scale,
            nothing,
            floor,
            floor[:, :, :0].copy(),
        )
        loop.filter_block(self.shaping, floor.reshape(len(floor), -1))

    def _sample(self, streams: list[np.random.Generator], shape: tuple[int, int]) -> np.ndarray:
        """White noise of variance 1, (runs, samples, channels), until the next call: fresh memory would cost as much."""
        size = shape[0] * shape[1]
        for stream, room in zip(streams, self.room, strict=True):
            stream.standard_normal(out=room[:size])
        return self.room[:, :size].reshape(-1, *shape)


@kernel
def _put(drawn, scale, added, first, second):
    """Channels of `first` and then of `second`: every run's `drawn` times the channel's `scale`, and what is `added`."""
    before = first.shape[2]
    for k in range(len(first)):
        for run in range(first.shape[1]):
            own = min(run, len(drawn) - 1)
            for c in range(before):
                first[k, run, c] = drawn[own, k, c] * scale[c] + added[k, c]
            for c in range(second.shape[2]):
                at = before + c
                second[k, run, c] = drawn[own, k, at] * scale[at] + added[k, at]
