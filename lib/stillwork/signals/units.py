"""Units: what each means, in every spelling that a file may have."""

import math
import re
import unicodedata
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache

from stillwork.base.checks import InputError, nearest
from stillwork.base.validation import by_value, checked

STANDARD_GRAVITY = 9.80665  # m/s^2
MOTION_UNITS = ("m/s^2", "m/s", "m")
QUANTITIES = (
    *MOTION_UNITS,
    "N",
    "N m",
    "V",
    "A",
    "Pa",
    "rad",
    "rad/s",
    "rad/s^2",
    "count",
    "count/s",
    "count/s^2",
)
SI_UNITS = (*QUANTITIES, "1")
POSITIONS, DRIVES = ("m", "rad", "count"), ("N", "N m", "A", "V")
# Of an acceleration, a velocity and a position: the position's unit, and the derivatives that an acceleration has more.
MOVES = {f"{each}{over}": (each, k) for each in POSITIONS for k, over in enumerate(("/s^2", "/s", ""))}
_PREFIXES = {"": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12, "k": 1e3}
_DEGREE = math.pi / 180
_LENGTHS = {"in": 0.0254, "ft": 0.3048, "mil": 25.4e-6, "uin": 25.4e-9}  # in m
_FORCES = {
    "lbf": 0.45359237 * STANDARD_GRAVITY,
    "ozf": 0.028349523125 * STANDARD_GRAVITY,
    "kgf": STANDARD_GRAVITY,
}  # in N
# What a unit means: factor to SI, and the SI unit.
UNITS = {
    **{f"{p}{q}": (factor, q) for q in QUANTITIES for p, factor in _PREFIXES.items()},
    **{f"{p}g": (factor * STANDARD_GRAVITY, "m/s^2") for p, factor in _PREFIXES.items() if p != "k"},
    **{f"c{q}": (0.01, q) for q in MOTION_UNITS},
    **{f"{p}deg{over}": (f * _DEGREE, f"rad{over}") for over in ("", "/s", "/s^2") for p, f in (("", 1), ("m", 1e-3))},
    "Grad": (_DEGREE, "rad"),  # of a file in German; grad may mean a 400th of a turn
    **{f"{p}Gal": (0.01 * factor, "m/s^2") for p, factor in (("", 1), ("m", 1e-3), ("u", 1e-6))},
    **{f"arc{part}": (_DEGREE / share, "rad") for part, share in (("min", 60), ("sec", 3600))},
    **{f"{each}{over}": (f, f"m{over}") for each, f in _LENGTHS.items() for over in ("", "/s", "/s^2")},
    **{each: (f, "N") for each, f in _FORCES.items()},
    **{f"{each} {long}": (f * _LENGTHS[long], "N m") for each, f in _FORCES.items() if each != "kgf" for long in ("in", "ft")},
    "psi": (_FORCES["lbf"] / 0.0254**2, "Pa"),
    **{each: (f, "Pa") for each, f in (("bar", 1e5), ("mbar", 100.0), ("hPa", 100.0))},
    "1": (1.0, "1"),
    "%": (0.01, "1"),
    **{f"{p}s": (factor, "s") for p, factor in _PREFIXES.items() if p != "k"},
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    **{f"{p}Hz": (factor, "Hz") for p, factor in _PREFIXES.items()},
}  # fmt: skip
UNITS_TEXT = (
    f"{', '.join(QUANTITIES)} or 1, with m, u, n, p or k in front, or cm/s^2, cm/s, cm, deg, arcsec, Gal, g, mg, ug, ng, "
    "in/s^2, in/s, in, ft, mil, lbf, kgf, lbf in, psi, bar"
)
# What stands in names and is no unit of a channel: never taken for a part of the name.
FOREIGN = "rpm|cpm|deg[ _]?[cfk]|dbm|dbv|dbu|kg|ohms?"
# Capital letters or small ones throughout a name: what is then one unit, and what may be two.
_AMBIGUOUS = ("mhz", "mpa", "mn", "grad")
FOLDED = {
    low: next(iter(same))
    for low in {each.lower() for each in UNITS} - set(_AMBIGUOUS)
    if len(same := {each for each in UNITS if each.lower() == low}) == 1
}
# Other spellings, replaced one after the other, in any case of letters and in this one.
WORDS = (
    (r"[\u03bc\u00b5]", "u"),
    (r"[\u00b7\u22c5]", "*"),
    (r"\u2212", "-"),
    (r"\bmilli[-_ ]?(?=[a-z])", "m"),
    (r"\bmicro[-_ ]?(?=[a-z])", "u"),
    (r"\bnano[-_ ]?(?=[a-z])", "n"),
    (r"\bkilo[-_ ]?(?=[a-z])", "k"),
    (r"(?:\b|_)per(?:\b|_)", "/"),
    (r"(?<=[a-z])\.(?=$|[\s/^)])", ""),
    (r"\b(?:cycles?|cyc)\s*/\s*s(?:ec(?:onds?)?)?$|\bcps\b", "Hz"),
    (r"\b(k?)(?:samples|sa)\s*/\s*s(?:ec(?:onds?)?)?$", "$1Hz"),
    (r"\bips\b", "in/s"),
    (r"\b(u?)(?:inch(?:es)?)\b", "$1in"),
    (r"\b(?:feet|foot)\b", "ft"),
    (r"\b(?:mils|thou)\b", "mil"),
    (r"\b(lb|oz)(?:s|f|sf)?\b", "$1f"),
    (r"\b([pnumk]?)(?:seconds?|secs?|sekunden?|sek)(?=[\d^]|\b)", "$1s"),
    (r"\b(?:minutes?|mins)\b", "min"),
    (r"\b(?:hours?|hrs?)\b", "h"),
    (r"\b([pnumk]?)hertz\b", "$1Hz"),
    (r"\b([pnumk]?)volts?\b", "$1V"),
    (r"\b([pnumk]?)newtons?\b", "$1N"),
    (r"\b([pnumk]?)(?:amperes?|amps?)\b", "$1A"),
    (r"\b([pnumkc]?)met(?:er|re)s?\b", "$1m"),
    (r"\b([pnumk]?)(?:radians?|rads)\b", "$1rad"),
    (r"\b(m?)(?:degrees?|degs)\b|\u00b0", "$1deg"),
    (r"\b(?:counts|cts|cnts?|lsbs?)\b", "count"),
    (r"^(?:per ?cent|pct|prozent)$", "%"),
    (r"^(?:-|abs|absolute|lin|linear|ratio|unitless|dimensionless)$", "1"),
    (r"\s*/\s*", "/"),
)
SYMBOLS = (
    (r"\s*(?:\*\*|\^)\s*", "^"),
    (r"\bs2\b", "s^2"),
    (r"^(?:[gG][\u2019']s|gs)$", "g"),
    (r"/s/s$", "/s^2"),
    (r"^([munpkc]?(?:m|rad|deg|count))[ *.]?s\^?-2$", "$1/s^2"),
    (r"^([munpkc]?(?:m|rad|deg|count))[ *.]?s\^?-1$", "$1/s"),
    (r"^([munpk]?)N[-* .]?m$", "$1N m"),
    (r"^(lbf|ozf)[-* .](in|ft)$|^(in|ft)[-* .](lbf|ozf)$", "$1$4 $2$3"),
)
ROOT = r"(?:\u221a|sqrt|rt)\s*\(?\s*hz\s*\)?|hz\s*\^?\s*\(\s*1\s*/\s*2\s*\)|hz\s*\^\s*(?:0?\.5|1/2)"  # of Hz
DECIBELS = (
    r"(?:db|decibels?)(?![a-z\d])\.?\s*(?:\(\s*)?(?:(?:re|ref|rel)\b[.:]?\s*)?"
    r"(\d+(?:\.\d*)?(?:e[-+]?\d+)?(?![\d.]*/))?\s*(.*?)\s*"
)
DENSITIES = (
    (r"\((.+)\)\^?2/Hz", 2),
    (r"([^\W\d_]+)\^?2/Hz", 2),
    (r"(.+)/rtHz", 1),
)


@by_value
@dataclass(frozen=True)
class Unit:
    """What a unit means."""

    factor: float  # to SI
    si: str  # SI unit; of a ratio that of its upper part
    upper: str  # as written, e.g. mm/s
    lower: str = ""  # of a ratio: what stands below, e.g. N
    lower_si: str = ""
    decibels: bool = False  # 20 log10 of the size over `reference`
    reference: float = 1.0
    power: int = 0  # of a density: to which it has the motion, per Hz or per sqrt(Hz)

    @property
    def ratio(self) -> bool:
        """Of a response to what drives it."""
        return self.si in MOVES and self.lower_si in DRIVES


@by_value
@dataclass(frozen=True)
class Reading:
    """What a reader took a column of a file for."""

    quantity: str  # frequency, magnitude, phase, real, imaginary, complex, coherence, force or response
    unit: str  # as it was read: Hz, rad/s, dB re 1 m/N, deg, m/s^2/N, ...
    column: str  # its name in the file
    written: bool  # in the file, or the caller gave it; otherwise it is the documented default


@checked
def unit_factor(unit: str) -> tuple[float, str]:
    """Factor to SI and the SI unit of `unit`; an unknown one raises `InputError` that names the nearest."""
    plain = spelled(unit)
    if not (found := _simple(plain)) or found[1] not in SI_UNITS:
        raise InputError(f"unit is {unit!r}; use {UNITS_TEXT}{nearest(plain, UNITS)}")
    return found


@cache
def meaning(text: str) -> Unit | None:
    """What a unit means, one of a density, a ratio or decibels too; None where it is not known."""
    plain = re.sub(ROOT, "rtHz", unicodedata.normalize("NFKC", text).strip(), flags=re.IGNORECASE)
    if found := re.fullmatch(DECIBELS, plain, flags=re.IGNORECASE):
        number, rest = found[1], found[2]
        if rest.endswith(")") and rest.count(")") > rest.count("("):
            rest = rest[:-1]
        linear = _linear(rest.strip() or "1")
        if linear is None or linear.power:
            return None
        return replace(linear, reference=float(number or 1), decibels=True)
    return _linear(plain)


def _linear(text: str) -> Unit | None:
    plain = spelled(text)
    if found := _simple(plain):
        return Unit(*found, plain)
    if plain == "1/kg":
        return Unit(1.0, "m/s^2", "m/s^2", "N", "N")
    squeezed = re.sub(r"hz$", "Hz", plain.replace(" ", ""), flags=re.IGNORECASE)
    for pattern, power in DENSITIES:
        if (found := re.fullmatch(pattern, squeezed)) and (motion := _simple(spelled(_bare(found[1])))):
            return Unit(*motion, _bare(found[1]), power=power)
    upper, _, lower = (spelled(_bare(each)) for each in plain.rpartition("/"))
    above, below = _simple(upper), _simple(lower)
    if above and below and (below[1] in DRIVES or below[1] == above[1]):
        return Unit(above[0] / below[0], above[1], upper, lower, below[1])
    return None


def _bare(text: str) -> str:
    """Without the brackets that enclose it."""
    return text.strip("() ")


@checked
def spelled(text: str) -> str:
    """A unit in the spelling of `UNITS`, as far as it is another spelling of one."""
    plain = unicodedata.normalize("NFKC", text).strip()
    for patterns, flags in ((WORDS, re.IGNORECASE), (SYMBOLS, 0)):
        for pattern, other in patterns:
            plain = re.sub(pattern, re.sub(r"\$(\d)", r"\\\1", other), plain, flags=flags)
    return plain


def _simple(plain: str) -> tuple[float, str] | None:
    if plain in UNITS:
        return UNITS[plain]
    # Of MHz, MM, MS, M and G nobody knows whether they are meant as they are written.
    if re.match(r"M[A-Za-z]|[GM]$", plain) or plain.lower() not in FOLDED:
        return None
    return UNITS[FOLDED[plain.lower()]]


@checked
def is_unit(text: str, wanted: Collection[str]) -> bool:
    """Whether `text` is a unit of one of these SI units."""
    found = _simple(spelled(text))
    return found is not None and found[1] in wanted
