"""The referee: runs anybody's observer in a process of its own, and shows it to the door by name and reason."""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from contest.nominal import NominalModel, NominalNoise
from stillwork.base.checks import InputError
from stillwork.base.kernel_folder import FOLDER_VARIABLE

SCAN_SECONDS = 120.0  # that one seed's scans of a plant may take, with their start
SERVER = Path(__file__).with_name("child.py")
# What of the environment an observer's process keeps, what is its folder, and what is "1" there.
KEPT = ("PATH", "LANG", "SYSTEMROOT", "LD_LIBRARY_PATH")
OWN = ("HOME", "TMPDIR", "NUMBA_CACHE_DIR", FOLDER_VARIABLE)
SWITCHED_ON = ("PYTHONDONTWRITEBYTECODE", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


class Disqualified(Exception):
    """Why an observer is out of the contest."""


class ExternalObserver:
    """An observer from a file: a class ``Observer`` with ``start(model, noise, sample_time)`` and ``step(input, measurement)``.

    Use it as a context. The file's process is given the nominal model and the noises at the start of a scan, then
    one force and one measurement after the other. It holds neither the truth nor what comes. Scans of one seed run
    side by side, each with noises of its own, so that a pipe is crossed once for all of them.
    """

    def __init__(self, file: str | Path, seconds: float = SCAN_SECONDS):
        self.file, self.seconds = Path(file).resolve(), seconds
        try:
            self.text = self.file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{file} cannot be read ({error}); give a Python file") from None

    def __enter__(self) -> "ExternalObserver":
        self.folder = tempfile.TemporaryDirectory(prefix="observer-")
        self.said = tempfile.TemporaryFile()
        down, self.requests = os.pipe()
        self.answers, up = os.pipe()
        # The toolbox may be used; the contest's own files may not be read.
        library = Path(__file__).parents[1] / "lib"
        environment = {name: os.environ[name] for name in KEPT if name in os.environ}
        environment |= dict.fromkeys(OWN, self.folder.name) | dict.fromkeys(SWITCHED_ON, "1")
        environment["PYTHONPATH"] = str(library)
        told = map(str, (SERVER, self.file, self.folder.name, library / "stillwork", down, up))
        self.process = subprocess.Popen(
            [sys.executable, "-P", *told],
            pass_fds=(down, up),
            stdin=subprocess.DEVNULL,
            stdout=self.said,
            stderr=self.said,
            cwd=self.folder.name,
            env=environment,
        )
        os.close(down)
        os.close(up)
        self.requests, self.answers = Connection(self.requests), Connection(self.answers)
        self.deadline = time.monotonic() + self.seconds
        try:
            self._ask("load", self.text)
        except Disqualified:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_) -> None:
        self.process.kill()
        self.process.wait()
        for each in (self.requests, self.answers, self.said):
            each.close()
        self.folder.cleanup()

    def start(self, told: Sequence[tuple[NominalModel, NominalNoise, float]]) -> None:
        """Begin scans that run side by side, with an ``Observer`` each."""
        self.deadline = time.monotonic() + self.seconds
        self.states = len(told[0][0].a)
        plain = [
            (asdict(model) | {"rigid_modes": model.rigid_modes}, asdict(noise), sample_time)
            for model, noise, sample_time in told
        ]
        self._ask("start", plain)

    def step(self, numbers: Sequence[int], inputs: np.ndarray, measurements: np.ndarray) -> np.ndarray:
        """Estimates of one sample of each of these scans."""
        answer = self._ask("step", (numbers, inputs, measurements))
        if len(answer) != 8 * len(numbers) * self.states:
            raise Disqualified("an answer of the wrong size")
        estimates = np.frombuffer(answer).reshape(len(numbers), self.states)
        if not np.isfinite(estimates).all():
            raise Disqualified("estimates that are not finite")
        return estimates

    def _ask(self, kind: str, message) -> bytes:
        with contextlib.suppress(BrokenPipeError):
            self.requests.send((kind, message))
        try:
            if not self.answers.poll(max(self.deadline - time.monotonic(), 0.0)):
                raise Disqualified(f"hangs: its scans take longer than {self.seconds:.0f} s")
            answer = self.answers.recv_bytes(1 << 20)
        except (EOFError, OSError):
            raise Disqualified("its process ends") from None
        if answer[:1] != b"+":
            raise Disqualified(answer[1:].decode(errors="replace"))
        if os.fstat(self.said.fileno()).st_size:
            raise Disqualified("prints")
        return answer[1:]
