"""A small workbook for the tests of what the site reads."""

from engine.conftest import toy

__all__ = ["toy"]
