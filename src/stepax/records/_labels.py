"""Names of what was recorded, and the units that they tell; host code."""

import re
from typing import NamedTuple


class Labels(NamedTuple):
    """Names of what was recorded, as they stand in the file, units included."""

    source: str = ""
    time: str = "time"
    output: str = "output"
    input: str = "input"


# A name before the brackets, so that "[K]" alone is a name, and no brackets inside them: of
# "T (box) [K]" the last ones count. `test_unit` has both.
_BRACKETED = re.compile(r"[^\s(\[].*[(\[]\s*([^()\[\]]*?)\s*[)\]]\s*$")
_APPENDED = re.compile(r".+[_,/;]\s*(\S+)\s*$")
# Without brackets only what is known: the end of "T_1" or "box_temp" is no unit.
_UNITS = set(
    "% s sec ms us min h hr d degC °C C K degF °F F V mV kV A mA uA W kW MW Hz rpm rad deg m mm cm"
    " um kg g l L m3 bar mbar Pa hPa kPa MPa psi N Nm J kJ ppm pH rad/s deg/s m/s mm/s l/min L/min"
    " l/h l/s m3/h m3/s kg/h kg/s mol/l S/m".split()
)


def unit_of(label: str) -> str:
    """Unit in a column's name: in brackets at its end, or a known one after `_` or a comma."""
    if match := _BRACKETED.match(label):  # y(t), u(k) and y(1) name an argument or a channel
        return "" if match[1] in ("t", "k") or match[1].isdigit() else match[1]
    match = _APPENDED.match(label)
    return match[1] if match and match[1] in _UNITS else ""


class Units(NamedTuple):
    """Units of a record's columns, empty where its labels have none."""

    time: str
    output: str
    input: str

    @classmethod
    def of(cls, labels: Labels) -> "Units":
        """Units that the labels of a record tell."""
        return cls(unit_of(labels.time), unit_of(labels.output), unit_of(labels.input))

    def unit(self, dimension: str) -> str:
        """Unit of a quantity by its dimension, empty where it is not known or there is none.

        "time", "per time" (an angular frequency), "1", "output", "output/input" (a gain) and
        "output/(input time)" (the gain of a plant that integrates).
        """
        output, input = _bracketed(self.output), _bracketed(self.input)
        per_input = f"{output}/{input}" if input else f"{self.output} per unit of input"
        slope = f"{output}/({input} {self.time})"
        slope = slope if input else f"{output}/{self.time} per unit of input"
        return {
            "time": self.time,
            "per time": f"rad/{self.time}" if self.time else "",
            "1": "",
            "output": self.output,
            "output/input": per_input if output else "",
            "output/(input time)": slope if output and self.time else "",
        }[dimension]

    @property
    def integral(self) -> str:
        """Unit of J: that of the output squared, times that of time."""
        return f"{_bracketed(self.output)}^2 {self.time}" if self.output and self.time else ""


def _bracketed(unit: str) -> str:
    """A unit as part of another."""
    return f"({unit})" if "/" in unit else unit


def is_unit(text: str) -> bool:
    """Whether a cell is a unit by itself: a known one, in brackets or not, or "-" for none."""
    inner = re.sub(r"^[(\[]\s*|\s*[)\]]$", "", text.strip())
    return inner in _UNITS or inner == "-" or (inner != text.strip() and bool(inner))


def with_unit(name: str, unit: str) -> str:
    """A name and its unit as they stand in the header of a file: "Temperature (degC)"."""
    unit = re.sub(r"^[(\[]\s*|\s*[)\]]$", "", unit.strip())
    return name if not unit or unit == "-" or unit_of(name) else f"{name} ({unit})"


def without_unit(name: str) -> str:
    """A name without its unit in brackets."""
    return re.sub(r"\s*[(\[][^()\[\]]*[)\]]\s*$", "", name) or name
