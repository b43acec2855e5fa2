"""Channels of TDMS files of LabVIEW, read by npTDMS."""

import re
from collections import Counter
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, one_line
from stillwork.base.extras import require_package
from stillwork.base.validation import checked
from stillwork.signals.structured_files import MOST_BYTES
from stillwork.signals.universal import add_axis

UNIT = ("unit_string", "NI_UnitDescription")  # properties that may hold a channel's


@checked
def read_tdms(path: Path) -> dict[str, np.ndarray]:
    """Every channel of numbers by name, with its unit, and the axis of waveforms: ``time (s)``, or what its properties state.

    A channel whose name stands in several groups is called ``group.channel``. Moments are given in seconds from the first.
    """
    nptdms = require_package("nptdms")
    try:
        with nptdms.TdmsFile.open(path) as file:
            channels = [each for group in file.groups() for each in group.channels()]
            if (size := 8 * sum(map(len, channels))) > MOST_BYTES:
                raise InputError(
                    f"{path.name} holds {size:.2g} bytes of numbers, more than {MOST_BYTES / 2**30:g} GB; cut it"
                )
            values = [each[:] for each in channels]
    except InputError:
        raise
    except Exception as error:  # on a damaged file its parser raises whatever it stumbles over
        raise InputError(
            f"{path.name} cannot be read as TDMS ({one_line(str(error))}); export it again, or CSV"
        ) from None
    named = Counter(each.name for each in channels)
    found: dict[str, np.ndarray] = {}
    for each, numbers in zip(channels, values, strict=True):
        if numbers.dtype.kind == "M" and len(numbers):
            numbers = (numbers - numbers[0]) / np.timedelta64(1, "s")
        if numbers.dtype.kind not in "fiuc" or not len(numbers):
            continue
        stated = each.properties
        if step := stated.get("wf_increment"):
            unit = stated.get("wf_xunit_string") or "s"
            name = stated.get("wf_xname") or ("frequency" if unit.lower().endswith("hz") else "time")
            axis = f"{name} ({unit})"
            add_axis(path, found, axis, stated.get("wf_start_offset", 0.0) + step * np.arange(len(numbers)))
        group = re.sub(r"\W+", "_", each.group_name)
        name = each.name if named[each.name] == 1 else f"{group}.{each.name}"
        unit = next((str(stated[key]) for key in UNIT if stated.get(key)), "")
        found[f"{name} ({unit})" if unit else name] = numbers
    if not found:
        held = ", ".join(f"{each.group_name}.{each.name} ({len(each)} of {each.dtype})" for each in channels)
        raise InputError(
            f"{path.name} holds no channel of numbers, but {held or 'nothing'}; export those of a measurement"
        )
    return found
