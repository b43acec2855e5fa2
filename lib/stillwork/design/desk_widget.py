"""The desk as a widget of Jupyter: the modules of the offline page, and what is designed on it as traits."""

import json
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import anywidget
import traitlets

from stillwork.base.checks import InputError
from stillwork.design.desk_page import widget_module


class _Design(traitlets.Dict):
    """Read as a copy: what is changed in place differs from what stands on the desk, so that setting it is a change."""

    def get(self, obj, cls=None):
        return deepcopy(super().get(obj, cls))


class DeskWidget(anywidget.AnyWidget):
    """The desk in a cell, and its state in Python, in both directions.

    Parameters
    ----------
    machine : mapping
        What `desk.machine_to_begin_with` returns.

    Attributes
    ----------
    design : dict
        The blocks as they stand (``{"blocks": [{"kind": ..., numbers}, ...], "limit": ...}``); set it, and the desk shows
        it. What it cannot show it refuses: then its own comes back. Empty until the cell is shown, here as in the two that
        follow, which are also empty where nothing can be computed.
    controller : str
        ``controller.toml`` of it, as `stillwork export` and `stillwork.control.load_controller` read it; empty without a
        sampling block.
    reached : dict
        ``stable``, ``bandwidth_hz``, ``peaks_db`` and ``peaks_in_box_db`` of ``output_sensitivity`` (the error, r to e) and
        ``input_sensitivity``; ``whole_box``: the whole box was searched, not its corners alone.
    machine : str
        Name of the machine on the desk: one may drop files on it, too.

    Examples
    --------
    >>> from stillwork.design.desk import machine_to_begin_with
    >>> from stillwork.design.desk_widget import DeskWidget
    >>> desk = DeskWidget(machine_to_begin_with(rate=5e3))
    >>> desk.design = {"blocks": [{"kind": "gain", "value": 1e5}, {"kind": "sampling", "rate_hz": 5e3}], "limit": None}
    >>> desk
    Desk of an example of 10 kg: 2 blocks, not shown
    """

    _esm = widget_module()
    machines = traitlets.List().tag(sync=True)
    machine = traitlets.Unicode().tag(sync=True)
    design = _Design().tag(sync=True)
    controller = traitlets.Unicode().tag(sync=True)
    reached = traitlets.Dict().tag(sync=True)

    def __init__(self, machine: Mapping[str, Any]):
        super().__init__(machines=[dict(machine)], machine=machine["name"])

    @traitlets.validate("design")
    def _check_design(self, proposal):
        value = proposal["value"]
        blocks = value.get("blocks")
        if value and not (
            isinstance(blocks, list) and all(isinstance(block, dict) and "kind" in block for block in blocks)
        ):
            raise InputError(
                'design must have "blocks", a list of dicts with a "kind"; take the desk\'s own, and change it'
            )
        try:  # what reaches the browser: numbers of NumPy are numbers
            return json.loads(json.dumps(value, allow_nan=False, default=lambda each: each.item()))
        except (AttributeError, TypeError, ValueError):
            raise InputError("design must hold finite numbers, words and lists alone") from None

    def __repr__(self) -> str:
        bandwidth = self.reached.get("bandwidth_hz")
        reached = f"{bandwidth:.4g} Hz" if bandwidth else "no crossing" if self.reached else "not shown"
        return f"Desk of {self.machine}: {len(self.design.get('blocks', []))} blocks, {reached}"
