"""Universal files for the tests, written by pyuff."""

import numpy as np

KINDS = {"time": (1, 17, 12, 0), "frf": (4, 18, 12, 13), "coherence": (6, 18, 0, 0)}


def function(kind, x, data, *, node=1, reference=0, unit="NONE", binary=0, **more):
    """A function of dataset 58 with every field that pyuff wants."""
    func_type, abscissa, ordinate, denominator = KINDS[kind]
    axes = ("abscissa", "ordinate", "orddenom", "z_axis")
    kinds = {f"{axis}_spec_data_type": 0 for axis in axes}
    units = {f"{axis}_{part}_unit_exp": 0 for axis in axes for part in ("len", "force", "temp")}
    labels = {f"{axis}_{label}": "NONE" for axis in axes for label in ("axis_lab", "axis_units_lab")}
    ends = {"rsp_ent_name": "NONE", "rsp_node": node, "rsp_dir": 3}
    ends |= {"ref_ent_name": "NONE", "ref_node": reference, "ref_dir": 3 if reference else 0}
    spaced = {"abscissa_spacing": 1, "abscissa_min": float(x[0]), "abscissa_inc": float(x[1] - x[0])}
    kinds |= {"abscissa_spec_data_type": abscissa, "ordinate_spec_data_type": ordinate}
    return {
        **{"type": 58, "binary": binary},
        **{"func_type": func_type, "func_id": 0, "ver_num": 0, "load_case_id": 0},
        **{f"id{k}": "NONE" for k in range(1, 6)},
        **(ends | spaced | kinds | units | labels),
        "orddenom_spec_data_type": denominator,
        "ordinate_axis_units_lab": unit,
        **{"z_axis_value": 0.0, "x": np.asarray(x), "data": np.asarray(data)},
        **more,
    }


def write_universal(path, functions):
    import pyuff

    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(functions, "add")  # "overwrite" loses the header of a binary set
    return path
