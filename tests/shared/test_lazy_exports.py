from importlib import import_module
from pkgutil import iter_modules

import pytest

PACKAGES = [
    *(
        f"stillwork.{name}"
        for name in ("signals", "lti", "identification", "estimation", "control", "machine")
    ),
    "workbook",
    *(f"experiments.{name}" for name in ("isolation", "motion", "fixedpoint")),
]


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_resolves(name):
    package = import_module(name)
    assert package.__all__ == dir(package)
    modules = {each.name for each in iter_modules(package.__path__)}
    assert not modules & set(package.__all__)  # a module that is imported would cover the name
    assert all(getattr(package, each) is not None for each in package.__all__)
    with pytest.raises(AttributeError, match=f"'{name}'.*'robot'"):
        package.robot  # noqa: B018
