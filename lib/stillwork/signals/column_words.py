"""The words of columns' names: what each stands for, and the units that such a column may have."""

from stillwork.signals.units import DRIVES, MOVES, POSITIONS

# Other writings of names: dB (re 1 m/N) is (dB re 1 m/N), |H| and abs(H) are a magnitude, arg(H) is a phase.
SPELLINGS = (
    (r"\b(db)\s*[(\[{]\s*((?:re|ref|rel)\b)", "($1 $2"),
    (r"\u2212", "-"),
    (r"\|([^|]*)\|", " magnitude ($1) "),
    (r"\babs(?=\s*\()", "magnitude"),
    (r"\u2220\s*([a-z]+\d*)", "phase ($1) "),
    (r"\b(?:arg|phi)(?=\s*\()", "phase"),
    (r"^H_\{[^{}]*\}$", "H"),  # of python-control, with the names of output and input
    (r"(sample|sampling)(?=freq)", "$1 "),
    (r"\((memory)\s*(\d*)\)", " $1 $2 "),  # behind the name of a trace: no unit
    (r"\b((?:acc|vel)[a-z]*(?:_?[xyz\d]+)?)_in_(s2?)$", "$1 in/$2"),  # inches; x_in_s is in seconds
)
NEGATED = (
    "-",
    "minus",
    "negative",
    "neg",
    "negated",
    "inverted",
    "flipped",
)  # before a quantity: of the other sign
MOTIONS = ("acceleration", "velocity", "position")
AXES = ("x", "axis", "value", "abscissa", "stimulus")
LETTER = r"[^\W\d_]"
ARGUMENT = (
    r"(?:[hgpstcl]\d*|f|jw)(?:\((?:f|s|z|w|jw|\d+, ?\d+)\))?"  # of a response, as in Re(H) and Re(H1(2,1))
)
SCALED = r"[*^\u00d7]|\d[eE]|\d{4}"  # a name that holds a factor
SEPARATORS = r"[\s_,;:/-]+"

# What the words of a name stand for, the units that a column of it may have, and the one that it has without any.
HOLDS = {
    "frequency": ("frequency frequencies freq freqs frequenz frequenzen fréquence frequentie f omega ω w kreisfrequenz pulsation", ("Hz", "rad/s"), "Hz"),
    "time": ("time times t zeit temps tijd timestamp", ("s",), "s"),
    "rate": ("fs rate samplerate abtastrate", ("Hz",), "Hz"),
    "magnitude": ("magnitude mag amplitude ampl gain betrag modulus", (*MOVES, "1", "V", "A", "N", "N m"), ""),
    "phase": ("phase angle winkel phi φ", ("rad",), "deg"),
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
OF_WORD = {word: quantity for quantity, (words, _, _) in HOLDS.items() for word in words.split()}
# Quantities whose names may hold nothing that is not understood, where they state no unit.
STRICT = ("frequency", "time", "rate", "magnitude", "phase", "real", "imaginary", "coherence", "force")
RESPONSES = ("magnitude", "phase", "real", "imaginary", "coherence")
OF_A_RESPONSE = (
    "force",
    "acceleration",
    "velocity",
    "position",
    "voltage",
    "current",
)  # a magnitude or a phase of these
RADIANS = ("omega", "ω", "w", "kreisfrequenz", "pulsation", "angular")  # a frequency called so is in rad/s
LABELS = (
    "angle axis vector array data value values part response resp function frf h g p s l c k x y z xy of in at on from to "
    "ch chan channel trace input output in out measured measurement meas avg average mean median sample sampling est estimate stamp base "
    "relative elapsed open closed loop plant sensor force acceleration velocity position displacement current voltage "
    "grid list unwrapped wrapped shift hammer hit run left right top bottom front rear upper lower tip impact point node dof "
    "lin linear absolute ratio"
).split()
# A column that one of these words names is another one than its quantity's.
OTHERS = (
    "log lg ln logarithmic logmag normalized normalised squared inverse reciprocal index bin bins error std stdev sigma "
    "variance deviation uncertainty resolution step delay lag margin stiffness impedance apparent attenuation loss"
).split()
LOGARITHMS = ("log", "logarithmic", "logmag")  # of a magnitude in decibels
