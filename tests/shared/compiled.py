"""C that the tests compile and call."""

import ctypes
import shutil
import subprocess

import numpy as np

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion"]


def compiled(files, folder, driver, *options):
    """The library made of `files` and of a `driver` that runs a record, with every warning an error, in C and C++."""
    for compiler in ("gcc", "g++"):
        assert shutil.which(compiler), f"{compiler} is not installed: apt-get install gcc g++ libc6-dev"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in {**files, "driver.c": driver}.items():
        (folder / name).write_text(text, encoding="utf-8")
    sources = [name for name in files if name.endswith(".c")]
    # The driver belongs to the tests: what is handed out is compiled for itself; C++ need only read it.
    for source in sources:
        call(["g++", "-std=c++17", "-x", "c++", *STRICT, *options, "-fsyntax-only", source], folder)
        call(["gcc", "-std=c99", *STRICT, *options, "-O2", "-fPIC", "-c", source], folder)
    objects = [source.removesuffix(".c") + ".o" for source in sources]
    call(["gcc", "-std=c99", "-O2", "-shared", "-fPIC", *objects, "driver.c", "-o", "all.so", "-lm"], folder)
    return ctypes.CDLL(str(folder / "all.so"))


def call(command, folder, errors=False):
    """Run a command and return what it prints, or its `errors`; a test fails with what it complains of."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stderr if errors else done.stdout


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


def run_controller(files, folder, inputs, outputs, dtype, first=None, known=None, flags=None):
    """Outputs (outputs, samples) of the C controller; with `first` it takes over from these outputs.

    `known` is fed forward; the flags of each sample go into `flags`.
    """
    (name,) = {file.removesuffix(".h") for file in files if not file.endswith(("_motion.h", ".c"))}
    driver = f"""
#include "{name}.h"
void run(long samples, const {name}_real *in, const {name}_real *known, const {name}_real *first, {name}_real *out,
         int *flags)
{{
    static const {name}_state zero;
    {name}_state s = zero;
    if (first)
        {name}_start(&s, &{name}_designed, in, known, first);
    for (long k = 0; k < samples; k++)
        flags[k] = (int){name}_step(&s, &{name}_designed, in + k * {name.upper()}_INPUTS,
                                    known + k * {name.upper()}_OUTPUTS, out + k * {name.upper()}_OUTPUTS);
}}
"""
    library = compiled(files, folder, driver)
    given = np.ascontiguousarray(inputs.T, dtype)
    found = np.zeros((len(given), outputs), dtype)
    fed = np.zeros_like(found) if known is None else np.ascontiguousarray(known.T, dtype)
    start = None if first is None else pointer(np.asarray(first, dtype))
    flags = np.zeros(len(given), np.int32) if flags is None else flags
    library.run(
        ctypes.c_long(len(given)), pointer(given), pointer(fed), start, pointer(found), pointer(flags)
    )
    return found.T.astype(float)
