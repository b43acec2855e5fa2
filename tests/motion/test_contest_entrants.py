"""Programs at a socket and libraries that break the contest's rules: each is out by its reason, and none is waited for."""

import contextlib
import json
import shutil
import socket
import socketserver
import subprocess
import threading
import time

import numpy as np
import pytest

from contest import runner
from contest.nominal import nominal_of
from contest.plants import plant_of
from contest.runner import Disqualified, ExternalObserver, can_isolate
from contest.scores import Scan, contest_trial
from contest.table import run_contest
from stillwork.base.checks import InputError

pytestmark = pytest.mark.slow
SCAN = Scan("estimate", "drive", "lost 20 %", "a test", 0)
MANY = 10**6


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(runner, "CPU_SECONDS", 1)
    monkeypatch.setattr(runner, "PATIENCE", 3)


@contextlib.contextmanager
def program(talk):
    """The address of a program that hands each connection's file to `talk`."""

    class Handler(socketserver.StreamRequestHandler):
        def handle(self):
            with contextlib.suppress(OSError):
                talk(self.rfile, self.wfile)

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True

    with Server(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"tcp:127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def answering(line, at=5):
    """A program that estimates zero, and `line` from one sample on; where that is a number, it waits so long first."""

    def talk(read, write):
        states = len(json.loads(read.readline())["model"]["a"])
        write.write(b"{}\n")
        for k, _ in enumerate(read):
            late = k == at and isinstance(line, float)
            time.sleep(line if late else 0)
            zero = json.dumps([0.0] * states).encode() + b"\n"
            write.write(line if k >= at and not isinstance(line, float) else zero)

    return talk


BROKEN = {
    "half a line": (b"[0.0, 0.0", "hangs: a scan takes more than 3 s"),
    "late": (4.0, "hangs: a scan takes more than 3 s"),
    "no answer": (b"", "hangs: a scan takes more than 3 s"),
    "no number": (b"[NaN, 0, 0, 0]\n", "no estimate: 4 finite numbers"),
    "beyond all numbers": (b"[1e999, 0, 0, 0]\n", "no estimate"),
    "a whole number beyond all numbers": (b"[1" + 400 * b"0" + b", 0, 0, 0]\n", "no estimate"),
    "too few": (b"[0, 0, 0]\n", "no estimate"),
    "too many": (b"[0, 0, 0, 0, 0]\n", "no estimate"),
    "in words": (b'["0", "0", "0", "0"]\n', "no estimate"),
    "true": (b"[true, true, true, true]\n", "no estimate"),
    "in a list of lists": (b"[[0, 0, 0, 0]]\n", "no estimate"),
    "an object": (b"{}\n", "no estimate"),
    "a huge line": (b"[" + MANY * b"0, " + b"0]\n", "more than 1048576 bytes"),
    "text": (b"hello\n", "not JSON"),
    "bytes that are no text": (b"\xff\xfe\n", "not JSON"),
    "nothing in a line": (b"\n", "not JSON"),
    "two in one line": (b"[0, 0, 0, 0][0, 0, 0, 0]\n", "not JSON"),
    "two lines": (b"[0, 0, 0, 0]\n[0, 0, 0, 0]\n", "before it is asked"),
    "its own reason": (b'{"error": "no idea"}\n', "^no idea$"),
}


def outcome(source):
    """Scores and the reason on one scan, and the time that this takes."""
    began = time.monotonic()
    scores, out = contest_trial([(SCAN, {"it": ()})], {"it": source})
    return {each.score: each.value for each in scores}, out.get("it", ""), time.monotonic() - began


@pytest.mark.parametrize("what", BROKEN)
def test_a_program_that_breaks_the_rules_is_out_by_reason(what, impatient):
    line, reason = BROKEN[what]
    with program(answering(line)) as source, pytest.raises(Disqualified, match=reason):
        began = time.monotonic()
        try:
            steps(source, 9)
        finally:
            assert time.monotonic() - began < 6


def steps(source, count):
    plant = plant_of("drive")
    with ExternalObserver(source) as observer:
        observer.start(*nominal_of(plant, 1.0), plant.sample_time)
        return [observer.step(np.zeros(1), np.zeros(1)) for _ in range(count)]


def test_a_program_may_write_its_lines_as_it_likes():
    with program(answering(b" [0,1e-3, -0.0,2]\r\n", at=0)) as source:
        assert steps(source, 2)[1].tolist() == [0.0, 1e-3, 0.0, 2.0]


def test_a_program_that_closes_is_out_and_the_others_go_on(monkeypatch):
    """While it runs, between two scans, or before all; the last is the reader's to mend."""

    def closes(read, write):
        read.readline()
        write.write(b"{}\n")
        read.readline()

    with program(closes) as source:
        assert outcome(source)[:2] == ({}, "its connection closes")
    _, reason, _ = outcome(source)
    assert reason.startswith("cannot be reached (")
    with pytest.raises(InputError, match="cannot be reached"):
        run_contest("a test", 1, [source])
    with pytest.raises(InputError, match="cannot be read"):
        ExternalObserver("tcp:127.0.0.1")


def test_a_program_that_reads_nothing_is_not_waited_for(impatient):
    with socket.create_server(("127.0.0.1", 0)) as server:
        with pytest.raises(Disqualified, match="hangs"):
            steps(f"tcp:127.0.0.1:{server.getsockname()[1]}", 1)


def test_what_a_program_keeps_between_scans_is_fair_and_no_more_isolated():
    counted = []

    def talk(read, write):
        counted.append(len(counted))
        answering(json.dumps([float(len(counted))] * 4).encode() + b"\n", at=0)(read, write)

    with program(talk) as source:
        first, second = (outcome(source)[0]["flexible"] for _ in range(2))
        assert first != second and not ExternalObserver(source).isolated
    assert len(counted) == 2


@pytest.mark.skipif(not can_isolate(), reason="this machine has no namespaces for an observer")
def test_a_file_that_answers_without_reading_is_not_waited_for(tmp_path, impatient):
    """What it is asked fills its pipe at last."""
    file = tmp_path / "mine.py"
    file.write_text(
        "import os, time\n"
        "class Observer:\n"
        "    def start(self, *_):\n"
        "        os.write(4, b'{}\\n')\n"
        "        for _ in range(6000):\n"
        "            os.write(4, b'[0, 0, 0, 0]\\n')\n"
        "        time.sleep(1000)\n"
    )
    began = time.monotonic()
    with pytest.raises(Disqualified, match="before it is asked"):
        steps(file, 5000)
    assert time.monotonic() - began < 10


LIBRARY = """
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>
static int states, step;
void observer_start(int n, int inputs, int outputs, const double *a, const double *b, const double *c,
                    const double *process, const double *sensor, double sample_time, int knobs, const double *settings)
{
    states = n;
}
void observer_step(const double *input, const double *measurement, double *estimate)
{
    for (int i = 0; i < states && step != 7; i++) estimate[i] = step;
    if (++step == 5) { BODY }
}
"""
BODIES = {
    "prints": (r'printf("1 mine\n"); fprintf(stderr, "x"); fflush(stdout);', ""),
    "writes on what it is given": ("((double *)input)[0] = ((double *)measurement)[0] = 9;", ""),
    "reads nowhere": ("step = *(volatile int *)0;", "its process ends by SIGSEGV"),
    "runs without an end": ("for (;;) step = 5;", "takes more than 1 s of the processor"),
    "sleeps": ("sleep(30);", "hangs: a scan takes more than 3 s"),
    "ends": ("exit(0);", "its process ends$"),
    "writes behind the estimate": ("estimate[states] = 1;", "an estimate of more than 4 states"),
    "is not a number": ("estimate[0] = NAN;", "not finite"),
    "writes nothing": ("step = 7;", "not finite"),
    "writes into the runner's pipe": ('for (int f = 0; f < 9; f++) write(f, "look\\n", 5);', "not JSON"),
}


@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")
@pytest.mark.parametrize("what", BODIES)
def test_a_library_that_breaks_the_rules_is_out_by_reason(what, tmp_path, monkeypatch):
    body, reason = BODIES[what]
    monkeypatch.setattr(runner, "CPU_SECONDS", 1)
    monkeypatch.setattr(runner, "PATIENCE", 3 if "hangs" in reason else 60)
    (tmp_path / "mine.c").write_text(LIBRARY.replace("BODY", body))
    subprocess.run(
        ["cc", "-w", "-shared", "-fPIC", "-o", tmp_path / "mine.so", tmp_path / "mine.c"], check=True
    )
    if not reason:
        assert steps(tmp_path / "mine.so", 7)[6].tolist() == [6.0] * 4
        return
    with pytest.raises(Disqualified, match=reason):
        steps(tmp_path / "mine.so", 9)


def test_what_is_no_library_is_out_by_reason(tmp_path):
    (tmp_path / "mine.so").write_text("no library")
    with pytest.raises(Disqualified, match=r"raises OSError: .*file too short"):
        steps(tmp_path / "mine.so", 1)
