"""C that the tests compile and call."""

import ctypes
import shutil
import subprocess

import numpy as np

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion"]


def compiled(files, folder, driver, *options):
    """The library made of `files` and of a `driver` that runs a record, with every warning an error."""
    assert shutil.which("gcc"), "gcc is not installed: apt-get install gcc libc6-dev"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in {**files, "driver.c": driver}.items():
        (folder / name).write_text(text, encoding="utf-8")
    sources = [name for name in files if name.endswith(".c")]
    # The driver belongs to the tests: what is handed out is compiled for itself first.
    for source in sources:
        checked = ["gcc", *STRICT, *options, "-O2", "-c", source, "-o", "checked.o"]
        done = subprocess.run(checked, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    whole = ["gcc", "-std=c99", "-O2", "-shared", "-fPIC", *sources, "driver.c", "-o", "all.so", "-lm"]
    done = subprocess.run(whole, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "all.so"))


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


def run_controller(files, folder, inputs, outputs, dtype, first=None):
    """Outputs (outputs, samples) of the C controller; with `first` it takes over from these outputs."""
    (name,) = {file.removesuffix(".c") for file in files if file.endswith(".c")}
    driver = f"""
#include "{name}.h"
void run(long samples, const {name}_real *in, const {name}_real *first, {name}_real *out)
{{
    const {name}_real none[{name.upper()}_INPUTS + {name.upper()}_OUTPUTS] = {{0}};
    {name}_state s;
    {name}_start(&s, first ? in : none, first ? first : none);
    for (long k = 0; k < samples; k++)
        {name}_step(&s, in + k * {name.upper()}_INPUTS, out + k * {name.upper()}_OUTPUTS);
}}
"""
    library = compiled(files, folder, driver)
    given = np.ascontiguousarray(inputs.T, dtype)
    found = np.zeros((len(given), outputs), dtype)
    start = None if first is None else np.asarray(first, dtype)
    library.run(
        ctypes.c_long(len(given)), pointer(given), None if start is None else pointer(start), pointer(found)
    )
    return found.T.astype(float)
