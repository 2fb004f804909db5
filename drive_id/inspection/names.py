"""What column names suggest: which columns form phases, and what they may be; names as text of a signals file."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

from drive_id.files.logs.column_log import UNIT

_PHASES = ("abc", "uvw", "rst", "123", "012", "xyz")
_PAIRS = (("d", "q", "dq"), ("alpha", "beta", "alpha_beta"), ("al", "be", "alpha_beta"))
_WORDS = {
    "current": ("i", "is", "im", "iabc", "idq", "cur", "curr", "current", "amp", "ampere", "strom", "a"),
    "voltage": ("u", "v", "us", "vs", "uabc", "vabc", "udq", "vdq", "volt", "voltage", "duty", "pwm", "spannung",
                "tastverh", "tastgrad", "mod", "modulation"),
    "reference": ("ref", "reference", "set", "setpoint", "cmd", "command", "target", "des", "desired", "soll", "star"),
    "angle": ("angle", "theta", "position", "pos", "phi", "rotor", "enc", "encoder", "counts", "epos", "winkel", "lage",
              "gamma", "th", "resolver", "el"),
    "speed": ("speed", "velocity", "vel", "omega", "rpm", "erpm", "n", "w", "drehzahl"),
    "dc": ("dc", "udc", "vdc", "ubus", "vbus", "bus", "link", "dclink", "zk", "uzk", "battery", "supply"),
    "time": ("t", "time", "timestamp", "zeit", "stamp", "ts", "tick", "ticks", "seconds", "sec", "secs", "today",
             "elapsed"),
}  # fmt: skip
_UNIT = "(?P<prefix>" + UNIT[1:].replace(")(", ")(?P<base>", 1)
_UNITS_IN_NAMES = (  # I1 [mA], I1/mA, I1 [0.1A]; I1_mA, I1 in mA, or the unit alone, as a log gives it; ms_today
    re.compile(rf"[\[({{</] *(?:(?P<factor>\d*[.,]?\d+) ?\*? ?)?{_UNIT} *[\])}}>]?(?: \(\d+\))?$", re.IGNORECASE),
    re.compile(rf"(?:^|[_ ]){_UNIT}(?: \(\d+\))?$"),
    re.compile(r"^(?P<prefix>[nuµm])(?P<base>s)_"),
    re.compile(r"(?:^|[_ ])(?P<prefix>[mk])(?P<base>[AVav])(?=[_ \[]|$)"),  # cur_mA_a, phase_current_ma[0]
)
_DOUBTFUL = re.compile(r"(?:^|[_ ])(ma|ka|mv|kv)(?=[_ \[]|$)")
"""Units in small letters, which may be words: ``ia_ma`` is a current in mA, or a moving average."""
_FACTOR = re.compile(r"[*×] ?\d|\b[AV]/ ?\d|[ ([]x ?\d|\d ?[mµu]?[AV]/[AV]\b")
"""A factor that no unit explains: ``ia *10``, ``[A/10]``, ``(x0.1A)``, ``(10mV/A)``."""
FACTORS = {"": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9, "k": 1e3}
"""Factor to the base of a unit by its prefix."""
_MEASURED = {"meas", "measured", "mes", "ist", "act", "actual", "fb", "feedback", "sensed"}
_DERIVED = {
    "filt",
    "filtered",
    "flt",
    "lp",
    "lpf",
    "obs",
    "observer",
    "observed",
    "est",
    "estimate",
    "estimated",
    "smooth",
    "hat",
    "ff",
    "feedforward",
    "pi",
    "emf",
    "bemf",
}
_TEMPERATURE = {"temp", "temperature", "temperatur", "ntc", "pt", "thermo"}
_LABVIEW_TIME = "x_value"
_YAML_WORDS = ("y", "n", "yes", "no", "on", "off", "true", "false", "null")
_UNITS = {"current": "A", "voltage": "V"}


@dataclass(frozen=True)
class NameGroup:
    """Columns that belong together by their names."""

    names: tuple[str, ...]
    frame: str  # "abc", "line_to_line", "alpha_beta" or "dq"
    stem: str  # what the names have in common
    missing: int = 2  # the phase that two of them lack, minus their sum

    def fields(self, signs: Sequence[int] = ()) -> str:
        """Return what a signals file says for them: phases in their order, a missing one before others as their sum."""
        entries = [quoted(name) for name in self.names]
        if self.frame == "abc" and len(entries) == 2 and self.missing != 2:
            terms = zip(entries, signs or (1, 1), strict=True)
            entries.insert(self.missing, "{" + ", ".join(f"{entry}: {-sign}" for entry, sign in terms) + "}")
        return f"[{', '.join(entries)}]"


def words(name: str) -> set[str]:
    """Return the words of a name in lower case, split at capitals, digits and signs."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    found = {word for word in re.split(r"[^a-zA-Z]+", spaced.lower()) if word}
    return found | {word.rstrip("s") for word in found if len(word) > 3}


def suggests(name: str, meaning: str) -> bool:
    """Whether a name suggests ``current``, ``voltage``, ``reference``, ``angle``, ``speed``, ``dc``, ``time``."""
    lower = name.lower().strip()
    marked = _UNITS_IN_NAMES[0].search(name.strip())
    unit = marked is not None and marked["base"].upper() == _UNITS.get(meaning)
    own = words(name) | ({"time"} if lower == _LABVIEW_TIME else set())
    long = any(word.startswith(stem) for stem in _WORDS[meaning] if len(stem) > 3 for word in own)
    return unit or long or bool(own & set(_WORDS[meaning]))


def is_measured(name: str) -> bool:
    """Tell whether a name says that what it holds was measured."""
    return bool(words(name) & _MEASURED)


def is_derived(name: str) -> bool:
    """Tell whether a name says that what it holds was filtered or estimated."""
    return bool(words(name) & _DERIVED)


def is_temperature(name: str, given: str = "") -> bool:
    """Tell whether a name, or the unit that the log gives, says that what it holds is a temperature."""
    unit = _stated(name, given)[2]
    degrees = unit in ("°C", "°F", "K") or (unit == "C" and not name.endswith("_C"))  # which may be a phase
    return bool(words(name) & _TEMPERATURE) or degrees or name.startswith("T_")


def stated_unit(name: str, given: str = "") -> tuple[str, str]:
    """Return prefix and base of the unit that the log gives, or that a name holds: ``I1 [mA]``, ``I1/mA``, ``u_kV``.

    Both are empty if none is stated, or a multiple of one, as in ``I1 [0.1A]``. A phase may pass for a unit, as in
    ``u_V``: other phases tell.
    """
    number, prefix, base = _stated(name, given)
    return (prefix, base) if number == 1 else ("", "")


def doubtful_unit(name: str) -> str:
    """Return the unit in a name that may be a word: ``ma`` in ``ia_ma``; empty if there is none."""
    found = _DOUBTFUL.search(name)
    return found[1] if found else ""


def states_factor(name: str) -> bool:
    """Tell whether a name states a factor whose sense it leaves open: ``I1 [A/10]``, ``I1 (10mV/A)``."""
    return _FACTOR.search(name) is not None


def unit_scale(name: str, given: str = "") -> tuple[float, str]:
    """Return the factor to the base of the unit that is stated, 0.1 for ``I1 [0.1A]``, and the base, empty for none."""
    number, prefix, base = _stated(name, given)
    return number * FACTORS[prefix], base


def _stated(name: str, given: str) -> tuple[float, str, str]:
    said = next((found for pattern in _UNITS_IN_NAMES if (found := pattern.search(given or name.strip()))), None)
    if said is None:
        return 1.0, "", ""
    number, base = said.groupdict().get("factor") or "1", said["base"]
    base = base.upper() if base in ("a", "v") else base.lower() if base == "S" else base
    return float(number.replace(",", ".")), said["prefix"].lower().replace("µ", "u"), base


def begin_alike(one: str, other: str) -> int:
    """Return how many letters two names have in common at their begin, as those of one axis of a machine."""
    return next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))


def name_groups(names: Sequence[str]) -> Iterator[NameGroup]:
    """Yield the triples of phases and the pairs of components among names, each once; triples of phases first."""
    known, seen, triples = set(names), set[tuple[str, ...]](), list[set[str]]()
    for group in (
        *_lines(names, known),
        *_triples(names, known),
        *_components(names, known),
        *_two_phases(names, known),
        *_repeated(names, known),
    ):
        two = group.frame == "abc" and len(group.names) == 2
        part = two and any(three.issuperset(group.names) for three in triples)
        if group.names not in seen and not part:
            seen.add(group.names)
            triples += [set(group.names)] if len(group.names) == 3 else []
            yield group


def _lines(names: Sequence[str], known: set[str]) -> Iterator[NameGroup]:
    """Yield voltages between phases: ``u_ab, u_bc, u_ca``, or the first two of them."""
    for name in names:
        for match in re.finditer(r"(?=([a-zA-Z1])([_-]?)([a-zA-Z2]))", name):
            one, sign, other = match.groups()
            for phases in _PHASES[:4]:
                a, b, c = (phases[k].upper() if one.isupper() else phases[k] for k in range(3))
                if (one, other) != (a, b):
                    continue
                pairs = ((a, b), (b, c), (c, a))
                head, tail = name[: match.start()], name[match.start() + 2 + len(sign) :]
                three = tuple(f"{head}{first}{sign}{second}{tail}" for first, second in pairs)
                stem = f"{head} {tail}"
                if stem.strip() and known.issuperset(three[:2]):
                    yield NameGroup(three if three[2] in known else three[:2], "line_to_line", stem)


def _triples(names: Sequence[str], known: set[str]) -> Iterator[NameGroup]:
    for name in names:
        for match in re.finditer(r"\d+", name):
            width = len(match.group())
            three = tuple(
                f"{name[: match.start()]}{int(match.group()) + j:0{width}d}{name[match.end() :]}" for j in range(3)
            )
            if known.issuperset(three):
                yield NameGroup(three, "abc", f"{name[: match.start()]} {name[match.end() :]}")
        for three, stem in _replaced(name):
            if known.issuperset(three):
                yield NameGroup(three, "abc", stem)
            for match in re.finditer(r"\d+", name):  # r69[0] Phase current U, r69[1] Phase current V
                first, last = match.span()
                both = tuple(f"{one[:first]}{int(match.group()) + k}{one[last:]}" for k, one in enumerate(three))
                if known.issuperset(both):
                    yield NameGroup(both, "abc", stem)


def _two_phases(names: Sequence[str], known: set[str]) -> Iterator[NameGroup]:
    """Yield any two of three phases, those of letters in use before neighbours of the alphabet."""
    for name in names:
        for phases, position in product(_PHASES, range(len(name))):
            own = phases.upper() if name[position].isupper() else phases
            head, tail = name[:position], name[position + 1 :]
            there = [f"{head}{phase}{tail}" in known for phase in own]
            if name[position] in own and sum(there) == 2 and (head + tail).strip():
                two = tuple(f"{head}{own[k]}{tail}" for k in range(3) if there[k])
                yield NameGroup(two, "abc", f"{head} {tail}", there.index(False))
    for name in names:
        for three, stem in _replaced(name):
            if known.issuperset(three[:2]) and three[2] not in known and stem:
                yield NameGroup(three[:2], "abc", stem)


def _repeated(names: Sequence[str], known: set[str]) -> Iterator[NameGroup]:
    """Yield groups of later columns of the same names, their number behind: a, b, c, a (5), b (6), c (7)."""
    later: dict[str, list[str]] = {}
    for name in names:
        base = re.sub(r" \(\d+\)$", "", name)
        if base != name and base in known:
            later.setdefault(base, []).append(name)
    for group in name_groups(list(later)) if len(later) > 1 else ():
        for repeated in zip(*(later[name] for name in group.names), strict=False):
            yield NameGroup(repeated, group.frame, group.stem)


def _replaced(name: str) -> Iterator[tuple[tuple[str, str, str], str]]:
    """Yield the names of three phases that begin with this one, with their stem, for each letter that may be one."""
    for position, letter in enumerate(name):
        for phases in _PHASES:
            if letter.lower() == phases[0]:
                own = phases.upper() if letter.isupper() else phases
                a, b, c = (name[:position] + phase + name[position + 1 :] for phase in own)
                yield (a, b, c), f"{name[:position]} {name[position + 1 :]}"
        alone = not (name[:position][-1:].isalnum() or name[position + 1 :][:1].isalnum())
        if alone and letter.isalpha() and len(name) > 1:  # channels D, E, F of a scope
            a, b, c = (name[:position] + chr(ord(letter) + k) + name[position + 1 :] for k in range(3))
            yield (a, b, c), f"{name[:position]} {name[position + 1 :]}"


def _components(names: Sequence[str], known: set[str]) -> Iterator[NameGroup]:
    for name in names:
        for one, other, frame in _PAIRS:
            for match in re.finditer(one, name.lower()):
                own = name[match.start() : match.end()]
                alike = str.upper if own.isupper() else str.capitalize if own[0].isupper() else str.lower
                second = name[: match.start()] + alike(other) + name[match.end() :]
                if second in known and second != name:
                    yield NameGroup((name, second), frame, f"{name[: match.start()]} {name[match.end() :]}")


def quoted(name: str) -> str:
    """Return a name for YAML, quoted unless it is a plain word."""
    if re.fullmatch(r"[A-Za-z_][\w.]*", name) and name.lower() not in _YAML_WORDS:
        return name
    return json.dumps(name, ensure_ascii=not name.isprintable())


def printable(name: str) -> str:
    """Return a name for a comment, without characters that end it."""
    return "".join(letter for letter in name if letter.isprintable())


def listed(names: Sequence[str]) -> str:
    """Return names as a list for YAML."""
    return "[" + ", ".join(quoted(name) for name in names) + "]"
