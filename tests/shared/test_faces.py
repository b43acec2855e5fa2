from importlib import import_module
from pathlib import Path

import pytest

PACKAGES = [
    *(
        f"stillwork.{name}"
        for name in ("signals", "lti", "identification", "estimation", "control", "workbook")
    ),
    *(f"experiments.{name}" for name in ("isolation", "motion", "worstcase", "fixedpoint")),
]


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_resolves_and_no_module_stands_in_its_place(name):
    package = import_module(name)
    assert package.__all__ == dir(package)
    modules = {file.stem for file in Path(package.__file__).parent.glob("*.py")}
    assert not modules & set(package.__all__)
    assert all(getattr(package, each) is not None for each in package.__all__)
    with pytest.raises(AttributeError, match=f"'{name}'.*'robot'"):
        package.robot  # noqa: B018
