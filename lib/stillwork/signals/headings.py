"""Names of columns: what each holds, and in which unit; one reading of names for every file and for the desk's page."""

import math
import re
import unicodedata
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, checked
from stillwork.signals.units import (
    DECIBELS,
    DENSITIES,
    DRIVES,
    FOLDED,
    MOVES,
    POSITIONS,
    ROOT,
    SYMBOLS,
    UNITS,
    WORDS,
    Reading,
    Unit,
    meaning,
    spelled,
)

_REFERENCE = r"\b(db)\s*[(\[{]\s*((?:re|ref|rel)\b)"  # dB (re 1 m/N) is (dB re 1 m/N)
_LETTER = r"[^\W\d_]"
_ARGUMENT = r"[hgpstcl]\d*|f|jw"  # of a response, as in Re(H)
_SCALED = r"[*^\u00d7]|\d[eE]|\d{4}"  # a name that holds a factor
_SEPARATORS = r"[\s_,;:/-]+"

# What the words of a name stand for, the units that a column of it may have, and the one that it has without any.
HOLDS = {
    "frequency": ("frequency frequencies freq freqs frequenz frequenzen fréquence frequentie f omega ω w kreisfrequenz pulsation", ("Hz", "rad/s"), "Hz"),
    "time": ("time times t zeit temps tijd timestamp", ("s",), "s"),
    "rate": ("fs rate samplerate abtastrate", ("Hz",), "Hz"),
    "magnitude": ("magnitude mag amplitude ampl gain betrag modulus", (*MOVES, "1", "V", "A", "N", "N m"), ""),
    "phase": ("phase angle winkel", ("rad",), "deg"),
    "real": ("real re realteil", (*MOVES, "1"), ""),
    "imaginary": ("imaginary imag im imaginärteil", (*MOVES, "1"), ""),
    "coherence": ("coherence coh kohärenz", ("1",), "1"),
    "force": ("force hammer kraft torque", DRIVES, "N"),
    "acceleration": ("acceleration accel acc beschleunigung", ("m/s^2", "rad/s^2", "count/s^2", "V"), ""),
    "velocity": ("velocity vel speed geschwindigkeit", ("m/s", "rad/s", "count/s", "V"), ""),
    "position": ("position pos displacement disp weg", (*POSITIONS, "V"), ""),
    "voltage": ("voltage spannung", ("V",), ""),
    "current": ("current strom", ("A",), ""),
}  # fmt: skip
_OF_WORD = {word: quantity for quantity, (words, _, _) in HOLDS.items() for word in words.split()}
# Quantities whose names may hold nothing that is not understood, where they state no unit.
_STRICT = ("frequency", "time", "rate", "magnitude", "phase", "real", "imaginary", "coherence", "force")
_RESPONSES = ("magnitude", "phase", "real", "imaginary", "coherence")
_OF_A_RESPONSE = (
    "force",
    "acceleration",
    "velocity",
    "position",
    "voltage",
    "current",
)  # a magnitude or a phase of these
_RADIANS = ("omega", "ω", "w", "kreisfrequenz", "pulsation", "angular")  # a frequency called so is in rad/s
_LABELS = (
    "angle axis vector array data value values part response resp function frf h g p s l c k x y z xy of in at on from to "
    "ch chan channel trace input output in out measured measurement meas avg average mean median sample sampling est estimate stamp base "
    "relative elapsed open closed loop plant sensor force acceleration velocity position displacement current voltage "
    "grid list unwrapped wrapped shift hammer hit run left right top bottom front rear upper lower tip impact point node dof "
    "lin linear absolute ratio"
).split()
# A column that one of these words names is another one than its quantity's.
_OTHERS = (
    "log lg ln logarithmic logmag normalized normalised squared inverse reciprocal index bin bins error std stdev sigma "
    "variance deviation uncertainty resolution step delay lag margin stiffness impedance apparent"
).split()
_LOGARITHMS = ("log", "logarithmic", "logmag")  # of a magnitude in decibels


@by_value
@dataclass(frozen=True)
class Heading:
    """What the name of a column states."""

    name: str
    quantity: str  # one of `HOLDS`, or nothing
    unit: str  # as written; empty: none
    meaning: Unit | None  # of the unit
    unknown: str = ""  # what stands where a unit does, but is none that is known, or none of this quantity
    strange: str = ""  # a word beside a quantity that may be a unit, and is none that is known


@cache
def heading(name: str) -> Heading:
    """What the name of a column states: ``freq_rad_s``, ``Gain dB``, ``Zeit in ms`` and ``CH1 Amplitude(dB)`` are read alike.

    A unit stands in brackets, or at the end behind ``_``, a blank, a comma, a slash or "in".
    """
    text = re.sub(ROOT, "rtHz", unicodedata.normalize("NFKC", name).strip(), flags=re.IGNORECASE)
    text = re.sub(_REFERENCE, r"(\1 \2", text, flags=re.IGNORECASE)
    text = re.sub(r"^(?:[^\W\d]\w*\.)+(?=[^\W\d])", "", text)  # a member of a structure
    rest, groups = _brackets(text)
    label, tail = _at_the_end(rest.strip(" ,;:/-_"))
    words = _words(label)
    if words[-1:] == ["in"]:
        words.pop()
    quantity = _quantity(words)
    if tail and (words or len(tail[0]) == 1) and not _is_stated(*tail, quantity):
        words, tail = [*words, tail[0].lower()], None
    if tail and not words and not groups:
        return Heading(name, _alone(*tail), *tail)
    if quantity in _RESPONSES:
        groups = [each for each in groups if not re.fullmatch(_ARGUMENT, each.lower())]
    if quantity and "1" not in HOLDS[quantity][1]:  # a number is that of a hit or of a channel
        groups = [each for each in groups if each != "1"]
    stated = [(each, unit) for each in groups if (unit := meaning(each))]
    odd = [each for each in groups if re.search(_LETTER, each) and not meaning(each)]
    if tail and stated and tail[1].decibels and tail[1].si == "1" and not stated[-1][1].decibels:
        unit = (f"dB re 1 {stated[-1][0]}", replace(stated[-1][1], decibels=True))
    else:
        stated += [tail] if tail else []
        unit = stated[-1] if stated else ("", None)
    means = unit[1]
    others = {re.sub(r"\d+$", "", each) for part in (label, *odd) for each in _words(part)} & set(_OTHERS)
    if quantity == "magnitude" and means and means.decibels:
        others -= set(_LOGARITHMS)
    if others - ({"squared"} if quantity == "coherence" else set()):
        quantity = ""
    if quantity == "force" and means and means.ratio:
        quantity = ""
    unknown = next((each for each, other in stated if not _same(other, stated[-1][1])), "")
    if odd and (means is None or (quantity in _STRICT and not set(_words(odd[-1])) <= set(_LABELS))):
        unknown = odd[-1]
    if quantity in _STRICT and means and means.si not in HOLDS[quantity][1]:
        if len(words[0]) == 1:  # f (mN) is a force, and no frequency
            quantity = ""
        else:
            unknown = unit[0]
    strange = _strange(label, words, quantity, means) if quantity in _STRICT and not unknown else ""
    return Heading(name, quantity, unit[0], None if unknown else means, unknown, strange)


def _words(text: str) -> list[str]:
    return re.findall(r"[^\W_]+", text.lower())


def _same(one: Unit, other: Unit) -> bool:
    return replace(one, upper="", lower="") == replace(other, upper="", lower="")


def _brackets(text: str) -> tuple[str, list[str]]:
    """A name without its brackets, and what stands in them, those within others with these."""
    rest, groups, depth, start = "", [], 0, 0
    for at, letter in enumerate(text):
        if letter in "([{":
            depth, start = depth + 1, start if depth else at + 1
        elif letter in ")]}" and depth:
            depth -= 1
            if not depth:
                groups.append(text[start:at].strip())
                rest += " "
        elif not depth:
            rest += letter
    return (f"{rest} {text[start:]}" if depth else rest), groups


def _at_the_end(text: str) -> tuple[str, tuple[str, Unit] | None]:
    """The longest unit at the end of a name, and what stands before it."""
    text = re.sub(r"(?<=\w)\s+\d+$", "", text)  # the number of a column of a matrix
    text = re.sub(r"_([munpk]?[mg])(_s2|_s)?_2_hz$", r"_(\1\2)^2/Hz", text, flags=re.IGNORECASE)
    text = re.sub(r"(?<=\w)(?=[%\u00b0])", " ", text)
    starts = [0, *(each.end() for each in re.finditer(_SEPARATORS, text))]
    camel = re.search(r"(?<=[a-z])[A-Z][A-Za-z]*$", text)
    for start in [*starts, *([camel.start()] if camel else [])]:
        part = text[start:]
        if not start and len(part) == 1:
            continue
        for each in (part, spelled(part.replace("_", "/"))):
            if unit := meaning(each):
                above = (
                    meaning(text[:start].rstrip(" /").rpartition(" ")[2])
                    if "/" in text[:start][-2:]
                    else None
                )
                if above and above.si in DRIVES and unit.si in MOVES:  # N/um is a stiffness
                    return text, None
                return text[:start].rstrip(" ,;:/-_"), (each, unit)
    return text, None


def _is_stated(text: str, unit: Unit, quantity: str) -> bool:
    """Whether what stands at the end of a name is its unit: no single letter, minimum or ratio of what is not understood."""
    if quantity in _STRICT or (quantity and unit.si in HOLDS[quantity][1]):
        return True
    return len(text) > 1 and (unit.decibels or unit.si not in ("s", "Hz", "1"))


def _quantity(words: list[str]) -> str:
    """What the last of the words that stand for a quantity stands for; single letters do only as the first."""
    found = ""
    for number, word in enumerate(words):
        plain = _bare_word(word) if len(word) > 2 else word
        after = words[number + 1 : number + 2]
        if plain not in _OF_WORD or (len(plain) == 1 and number):
            continue
        if plain == "rate" and number and words[number - 1] not in ("sample", "sampling"):
            continue
        if _OF_WORD[plain] in ("frequency", "time") and after in (["response"], ["resp"], ["responses"]):
            continue
        if found not in _RESPONSES or _OF_WORD[plain] not in _OF_A_RESPONSE:
            found = _OF_WORD[plain]
    return found


def _alone(text: str, unit: Unit) -> str:
    """What a column holds whose whole name is a unit."""
    if unit.decibels:
        return "magnitude"
    held = {"Hz": "frequency", "rad": "phase", "s": "time" if len(text) > 1 else ""}
    return held.get(unit.si, "")


def _strange(label: str, words: list[str], quantity: str, means: Unit | None) -> str:
    """A word of a name that may be a unit, but is not the one that the name states."""
    if re.search(_SCALED, label):
        return label
    last = max(k for k, word in enumerate(words) if _OF_WORD.get(_bare_word(word)) == quantity)
    for number, word in enumerate(words):
        plain = _bare_word(word)
        if plain in _LABELS or plain in _OF_WORD or plain.isdigit():
            continue
        if (means is None and number > last) or (len(word) > 1 and meaning(word)):
            return word
    return ""


def _bare_word(word: str) -> str:
    """Without the number at its end."""
    return re.sub(r"(?<=[^\d])\d+$", "", word)


@checked
def known_units(quantity: str) -> str:
    """The units that a column of a quantity may have, as a text."""
    if quantity in ("magnitude", "real", "imaginary"):
        return f"a motion over a force such as m/s^2/N, g/N or um/V{', dB re 1 m/N or dB' * (quantity == 'magnitude')}, or 1"
    wanted = HOLDS[quantity][1]
    return ", ".join(each for each, (_, si) in UNITS.items() if si in wanted and each != "Grad")


@checked
def column_unit(name: str, quantity: str, read_as: str = "") -> tuple[Unit, Reading]:
    """What the numbers of a column of a quantity mean: by its name, by `read_as`, or by the documented default.

    A unit that is not known, or is none of the quantity, raises `InputError` with those that are.
    """
    stated = heading(name)
    if (odd := stated.unknown or stated.strange) and not read_as:
        raise InputError(
            f"{name!r}: {odd!r} is no unit that is known; name it with one of {known_units(quantity)}, "
            "or without any"
        )
    by_name = quantity == "frequency" and any(
        each in _RADIANS for each in re.findall(r"[^\W\d_]+", name.lower())
    )
    text = read_as or stated.unit or ("rad/s" if by_name else HOLDS[quantity][2]) or "1"
    unit = meaning(text)
    if (
        unit is None
        or unit.si not in HOLDS[quantity][1]
        or unit.power
        or (unit.decibels and quantity != "magnitude")
    ):
        raise InputError(f"{name!r}: {text!r} is no unit of a {quantity}; use one of {known_units(quantity)}")
    return unit, Reading(quantity, text, name, bool(read_as or stated.unit) or by_name)


@checked
def in_hertz(unit: Unit) -> float:
    """Factor to Hz of a unit of frequencies."""
    return unit.factor / (2 * math.pi) if unit.si == "rad/s" else unit.factor


def page_table() -> dict[str, Any]:
    """All of it as the desk's page reads it, whose headings.js reads names alike."""
    return {
        "words": WORDS,
        "symbols": SYMBOLS,
        "root": ROOT,
        "decibels": DECIBELS,
        "densities": DENSITIES,
        "reference": _REFERENCE,
        "argument": _ARGUMENT,
        "scaled": _SCALED,
        "separators": _SEPARATORS,
        "units": UNITS,
        "folded": FOLDED,
        "holds": HOLDS,
        "strict": _STRICT,
        "responses": _RESPONSES,
        "of_a_response": _OF_A_RESPONSE,
        "radians": _RADIANS,
        "labels": _LABELS,
        "others": _OTHERS,
        "logarithms": _LOGARITHMS,
        "positions": POSITIONS,
        "drives": DRIVES,
        "moves": MOVES,
        "known": {each: known_units(each) for each in HOLDS},
    }
