"""Names of columns: what each holds, and in which unit; one reading of names for every file and for the desk's page."""

import math
import re
import unicodedata
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, checked
from stillwork.signals.column_words import (
    ARGUMENT,
    AXES,
    HOLDS,
    LABELS,
    LETTER,
    LOGARITHMS,
    MOTIONS,
    NEGATED,
    OF_A_RESPONSE,
    OF_WORD,
    OTHERS,
    RADIANS,
    RESPONSES,
    SCALED,
    SEPARATORS,
    SPELLINGS,
    STRICT,
)
from stillwork.signals.units import (
    DECIBELS,
    DENSITIES,
    DRIVES,
    FOLDED,
    FOREIGN,
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


@by_value
@dataclass(frozen=True)
class Heading:
    """What the name of a column states."""

    name: str
    quantity: str  # one of `HOLDS`, or nothing
    unit: str  # as written; empty: none
    meaning: Unit | None  # of the unit
    unknown: str = ""  # what stands where a unit does, but is none that is known, or none of this quantity
    strange: str = (
        ""  # a word beside a quantity that may be a unit, and is none that is known, or one of the sign
    )

    @checked
    def refusal(self, quantity: str) -> str:
        """Why its numbers cannot be read as this quantity, and what to do; empty: they can."""
        if self.strange in NEGATED:
            return f"{self.strange!r} turns its sign; turn that of its numbers, and name it without"
        if not (odd := self.unknown or self.strange):
            return ""
        return f"{odd!r} is no unit that is known; convert it to one of these and name it so: {known_units(quantity)}; or leave it out of the name"


@cache
def heading(name: str) -> Heading:
    """What the name of a column states: ``freq_rad_s``, ``Gain dB``, ``Zeit in ms`` and ``CH1 Amplitude(dB)`` are read alike.

    A unit stands in brackets, or at the end behind ``_``, a blank, a comma, a slash or "in".
    """
    text = _plain(name)
    rest, groups = _brackets(text)
    label, tail = _at_the_end(rest.strip(" ,;:/-_"))
    words = _words(label)
    inches = words[-1:] == ["in"] and not groups and not tail  # or a preposition, or an input
    if words[-1:] == ["in"]:
        words.pop()
    quantity = _quantity(words)
    axis = not quantity and tail and _abscissa(words, tail[1])  # X-Axis Hz
    if tail and (words or len(tail[0]) == 1) and not axis and not _is_stated(*tail, quantity):
        words, tail = [*words, tail[0].lower()], None
    if tail and not words and not groups:
        return Heading(name, _alone(*tail), *tail)
    groups = _of_units(groups, quantity)
    odd = [each for each in groups if re.search(LETTER, each) and not meaning(each)]
    stated, unit = _stated(groups, tail)
    means = unit[1]
    quantity = _unless_another(quantity or _abscissa(words, means), label, odd, means)
    unknown = next((each for each, other in stated if not _same(other, stated[-1][1])), "")
    if odd and (means is None or (quantity in STRICT and not set(_words(odd[-1])) <= set(LABELS))):
        unknown = odd[-1]
    if means is None and not unknown:
        unknown = "in" if inches and quantity in MOTIONS else _foreign(label)
    if quantity in STRICT and means and means.si not in HOLDS[quantity][1]:
        if len(words[0]) == 1:  # f (mN) is a force, and no frequency
            quantity = ""
        else:
            unknown = unit[0]
    strange = _strange(text, label, words, quantity, means) if quantity in STRICT and not unknown else ""
    return Heading(name, quantity, unit[0], None if unknown else means, unknown, strange)


def _plain(name: str) -> str:
    """A name in the letters in which it is read, without the structure of which it is a member."""
    text = re.sub(ROOT, "rtHz", unicodedata.normalize("NFKC", name).strip(), flags=re.IGNORECASE)
    for pattern, other in SPELLINGS:
        text = re.sub(pattern, re.sub(r"\$(\d)", r"\\\1", other), text, flags=re.IGNORECASE)
    return re.sub(r"^(?:[^\W\d]\w*\.)+(?=[^\W\d])", "", text)


def _of_units(groups: list[str], quantity: str) -> list[str]:
    """Those of the brackets that may hold a unit: no argument of a response, no number of a hit or of a channel."""
    if quantity in RESPONSES:
        groups = [each for each in groups if not re.fullmatch(ARGUMENT, each.lower())]
    if quantity and "1" not in HOLDS[quantity][1]:
        groups = [each for each in groups if each != "1"]
    return groups


def _stated(
    groups: list[str], tail: tuple[str, Unit] | None
) -> tuple[list[tuple[str, Unit]], tuple[str, Unit | None]]:
    """All units in the brackets and at the end of a name, and the one that counts."""
    stated = [(each, unit) for each in groups if (unit := meaning(each))]
    if tail and stated and tail[1].decibels and tail[1].si == "1" and not stated[-1][1].decibels:
        return stated, (f"dB re 1 {stated[-1][0]}", replace(stated[-1][1], decibels=True))
    stated += [tail] if tail else []
    return stated, stated[-1] if stated else ("", None)


def _abscissa(words: list[str], means: Unit | None) -> str:
    """What an x-axis in seconds or in Hz is."""
    if means is None or not words or not set(words) <= set(AXES):
        return ""
    return {"s": "time", "Hz": "frequency"}.get(means.si, "")


@checked
def is_bare_abscissa(name: str) -> bool:
    """Whether a name says no more than that the others stand over its column: ``X-Axis``."""
    words = set(_words(name))
    return words <= set(AXES) and bool(words - {"axis", "value"})


def _unless_another(quantity: str, label: str, odd: list[str], means: Unit | None) -> str:
    """The quantity, or nothing where a word of the name makes another one of it."""
    others = {re.sub(r"^\d+|\d+$", "", each) for part in (label, *odd) for each in _words(part)} & set(OTHERS)
    if quantity == "magnitude" and means and means.decibels:
        others -= set(LOGARITHMS)
    if others - ({"squared"} if quantity == "coherence" else set()):
        return ""
    return "" if quantity == "force" and means and means.ratio else quantity


def _foreign(label: str) -> str:
    """A unit at the end of a name that no channel has: one of those listed, or a ratio that is none, such as N/um."""
    if found := re.search(rf"(?:^|[\s_,;:/-])({FOREIGN})$", label, flags=re.IGNORECASE):
        return found[1]
    found = re.search(r"(?:^|[\s_,;:])([^\s_,;:/]+) ?/ ?([^\s_,;:/]+)$", label)
    return found[0].strip() if found and spelled(found[1]) in UNITS and meaning(found[2]) else ""


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
    starts = [0, *(each.end() for each in re.finditer(SEPARATORS, text))]
    camel = re.search(r"(?<=[a-z])[A-Z][A-Za-z]*$", text)
    for start in [*starts, *([camel.start()] if camel else [])]:
        part = text[start:]
        if not start and len(part) == 1:
            continue
        if part.lower() == "in":  # inches stand in brackets
            break
        flat = part if part.lower().startswith("in_") else part.replace("_", "/")
        for each in (part, spelled(flat)):
            if unit := meaning(each):
                before = re.search(r"([^ ]*) ?/ ?$", text[:start])
                if before and spelled(before[1]) in UNITS:  # N/um is a stiffness, N s/m a damper
                    return text, None
                return text[:start].rstrip(" ,;:/-_"), (each, unit)
    return text, None


def _is_stated(text: str, unit: Unit, quantity: str) -> bool:
    """Whether what stands at the end of a name is its unit: no single letter, minimum or ratio of what is not understood."""
    if quantity in RESPONSES and text.lower() == "h":  # no hours
        return False
    if quantity in STRICT or (quantity and unit.si in HOLDS[quantity][1]):
        return True
    return len(text) > 1 and (unit.decibels or unit.si not in ("s", "Hz", "1"))


def _quantity(words: list[str]) -> str:
    """What the last of the words that stand for a quantity stands for; single letters do only as the first."""
    found = ""
    for number, word in enumerate(words):
        plain = _bare_word(word) if len(word) > 2 else word
        after = words[number + 1 : number + 2]
        if plain not in OF_WORD or (len(plain) == 1 and number):
            continue
        sampled = number and words[number - 1] in ("sample", "sampling")
        if plain == "rate" and number and not sampled:
            continue
        if OF_WORD[plain] in ("frequency", "time") and after in (["response"], ["resp"], ["responses"]):
            continue
        if found not in RESPONSES or OF_WORD[plain] not in OF_A_RESPONSE:
            found = "rate" if sampled and OF_WORD[plain] == "frequency" else OF_WORD[plain]
    return found


def _alone(text: str, unit: Unit) -> str:
    """What a column holds whose whole name is a unit."""
    if unit.decibels:
        return "magnitude"
    held = {"Hz": "frequency", "rad": "phase", "s": "time" if len(text) > 1 else ""}
    return held.get(unit.si, "")


def _strange(text: str, label: str, words: list[str], quantity: str, means: Unit | None) -> str:
    """What of a name turns its sign or scales its numbers, or may be a unit, but is not the one that the name states."""
    if re.match(rf"-\s*{LETTER}", text):
        return "-"
    if turned := next((word for word in words if word in NEGATED), ""):
        return turned
    if re.search(SCALED, label):
        return label
    last = max(
        (k for k, word in enumerate(words) if OF_WORD.get(_bare_word(word)) == quantity), default=len(words)
    )
    for number, word in enumerate(words):
        plain = _bare_word(word)
        if plain in LABELS or plain in OF_WORD or plain.isdigit():
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
    if (refusal := stated.refusal(quantity)) and not read_as:
        raise InputError(f"{name!r}: {refusal}")
    by_name = quantity == "frequency" and any(
        each in RADIANS for each in re.findall(r"[^\W\d_]+", name.lower())
    )
    text = read_as or stated.unit or ("rad/s" if by_name else HOLDS[quantity][2]) or "1"
    unit = meaning(text)
    if (
        unit is None
        or unit.si not in HOLDS[quantity][1]
        or unit.power
        or (unit.decibels and quantity != "magnitude")
    ):
        raise InputError(
            f"{name!r}: {text!r} is no unit of {'an' if quantity[0] in 'aeiou' else 'a'} {quantity}; use one of {known_units(quantity)}"
        )
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
        "spellings": SPELLINGS,
        "negated": NEGATED,
        "motions": MOTIONS,
        "axes": AXES,
        "foreign": FOREIGN,
        "argument": ARGUMENT,
        "scaled": SCALED,
        "separators": SEPARATORS,
        "units": UNITS,
        "folded": FOLDED,
        "holds": HOLDS,
        "strict": STRICT,
        "responses": RESPONSES,
        "of_a_response": OF_A_RESPONSE,
        "radians": RADIANS,
        "labels": LABELS,
        "others": OTHERS,
        "logarithms": LOGARITHMS,
        "positions": POSITIONS,
        "drives": DRIVES,
        "moves": MOVES,
        "known": {each: known_units(each) for each in HOLDS},
    }
