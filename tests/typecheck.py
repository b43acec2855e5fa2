"""The tests' type checker: beartype, with an int serving as a float, as PEP 484 and everybody's code have it."""

from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
