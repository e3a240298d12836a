"""Names of what was recorded, and the units that they tell; host code."""

import re
from typing import NamedTuple


class Labels(NamedTuple):
    """Names of what was recorded, as they stand in the file, units included."""

    source: str = ""
    time: str = "time"
    output: str = "output"
    input: str = "input"


_BRACKETED = re.compile(r"[^\s(\[].*[(\[]\s*([^()\[\]]*?)\s*[)\]]\s*$")


_APPENDED = re.compile(r".+[_,/;]\s*(\S+)\s*$")


_UNITS = set(
    "% s sec ms us min h hr d degC °C C K degF °F F V mV kV A mA uA W kW MW Hz rpm rad deg m mm cm"
    " um kg g l L m3 bar mbar Pa hPa kPa MPa psi N Nm J kJ ppm pH rad/s deg/s m/s mm/s l/min L/min"
    " l/h l/s m3/h m3/s kg/h kg/s mol/l S/m".split()
)


def unit_of(label: str) -> str:
    """Unit in a column's name: in brackets at its end, or a known one after `_` or a comma."""
    if match := _BRACKETED.match(label):
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

    def parameter(self, name: str) -> str:
        """Unit of a model's parameter."""
        if name == "gain":
            return self._gain()
        if name == "offset":
            return self.output
        if name == "omega_n":
            return f"rad/{self.time}" if self.time else ""
        return "" if name in ("r", "n", "zeta") else self.time

    def _gain(self) -> str:
        if not self.output:
            return ""
        output, input = (f"({u})" if "/" in u else u for u in (self.output, self.input))
        return f"{output}/{input}" if input else f"{self.output} per unit of input"

    @property
    def integral(self) -> str:
        """Unit of J: that of the output squared, times that of time."""
        output = f"({self.output})" if "/" in self.output else self.output
        return f"{output}^2 {self.time}" if self.output and self.time else ""
