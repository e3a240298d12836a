"""What the paper prints: tables 1, 3 and 4 to 8, with points for decimal commas.

P. Jakoubek, "Experimental Identification of Stable Nonoscillatory Systems from Step-Responses by
Selected Methods". Table 2 is missing in it.
"""

import math
from typing import NamedTuple

from experiments.jakoubek.systems import chain
from stepax import PTn


METHODS = {
    "viteckova_1": "Vítečková, 1st order",
    "viteckova_2": "Vítečková, 2nd order",
    "latzel": "Latzel",
    "harriott": "Harriott",
    "smith": "Smith",
    "strejc": "Strejc",
    "sundaresan_krishnaswamy": "Sundaresan & Krishnaswamy",
}

REPRODUCED = "reproduced"
NOT_SUITED = "not suited, confirmed"
MISPRINT = "misprint"
CHART = "misread chart"
CONTRADICTION = "not its own formula"


class Cell(NamedTuple):
    """One row of tables 4 to 8.

    `lags` and `delay` in seconds and `J` in (output unit)^2 s, as printed; one lag stands for all
    `order`. No lags: "The Method doesn't suit for the system approximation". `verdict` is how it
    compares with the paper's own formulae and sampling, `why` the difference.
    """

    method: str
    lags: tuple[str, ...]
    order: int
    delay: str
    J: str
    verdict: str
    why: str = ""

    @property
    def plant(self) -> PTn | None:
        """The printed model."""
        return chain(self.values, float(self.delay)) if self.lags else None

    @property
    def values(self) -> list[float]:
        """Every printed lag, the largest first."""
        return [float(x) for x in self.printed_lags]

    @property
    def printed_lags(self) -> list[str]:
        repeated = self.lags * (self.order if len(self.lags) == 1 else 1)
        return sorted(repeated, key=float, reverse=True)


def half_unit(printed: str) -> float:
    """Half a unit of the last digit: three digits, at most four decimals, trailing zeros cut."""
    size = math.floor(math.log10(float(printed)))
    return 0.5 * 10.0 ** max(size - 2, -4)


_BEYOND = "t20/t60 is above 0.5551, the end of the curve"
_NOT_DIVIDED = "y(t2) not divided by the gain 2: beyond table 2, one lag left of two"
_COPIED = (
    "tau is that of Sundaresan & Krishnaswamy; J belongs to tau = {}, y_i = 0.359 met on y, not y/K"
)
_RATIO = "sum and dead time by formula; ratio tau1/sum 0.736 instead of {}"

TABLES = {
    "S1": (
        Cell("viteckova_1", ("0.499",), 1, "0.0013", "3.32e-6", REPRODUCED),
        Cell("sundaresan_krishnaswamy", ("0.496",), 1, "0.0053", "5.89e-5", REPRODUCED),
        Cell("strejc", ("0.507",), 1, "0", "8.59e-5", REPRODUCED),
        Cell(
            "harriott", ("0.2", "0.304"), 2, "0", "2.61e-2", CONTRADICTION,
            "y(t1) = 0.396 is beyond the curve, which ends at one lag; printed ratio 0.603",
        ),
        Cell(
            "smith", ("0.373", "0.0057"), 2, "0", "3.43e-2", CONTRADICTION,
            "t20/t60 = 0.2435 is one lag of 0.5; printed sum 0.379",
        ),
        Cell("latzel", ("0.201",), 2, "0", "4.05e-2", REPRODUCED),
        Cell("viteckova_2", ("0.318",), 2, "0", "8.49e-2", REPRODUCED),
    ),
    "S2": (
        Cell("latzel", ("0.5",), 2, "0", "7.92e-7", REPRODUCED),
        Cell("viteckova_2", ("0.5",), 2, "0", "9.74e-7", REPRODUCED),
        Cell(
            "harriott", ("0.487", "0.509"), 2, "0", "4.85e-5", CHART,
            "ratio 0.511 where the curve starts at 0.5",
        ),
        Cell("viteckova_1", ("0.784",), 1, "0.276", "8.46e-3", REPRODUCED),
        Cell(
            "smith", ("0.743", "0.350"), 2, "0", "1.02e-2", CHART,
            "zeta 1.072, t60/tau 1.986 where the curve has 1, 2.0223",
        ),
        Cell("sundaresan_krishnaswamy", ("0.722",), 1, "0.316", "1.16e-2", REPRODUCED),
        Cell("strejc", ("1.01",), 1, "0", "5.50e-2", CONTRADICTION, _NOT_DIVIDED),
    ),
    "S3": (
        Cell(
            "harriott", ("0.975", "0.115"), 2, "0", "2.38e-4", CHART,
            "ratio 0.894 where the curve has 0.902",
        ),
        Cell(
            "viteckova_1", ("0.1",), 1, "0.105", "4.38e-4", MISPRINT,
            "0.1 for 1.00: J is that of 1.00",
        ),
        Cell(
            "smith", ("1.03", "0.0932"), 2, "0", "6.13e-4", CHART,
            "zeta 1.813, t60/tau 3.302 where the curve has 1.7393, 3.2307",
        ),
        Cell("sundaresan_krishnaswamy", ("0.993",), 1, "0.117", "8.64e-4", REPRODUCED),
        Cell("strejc", ("1.1",), 1, "0", "7.26e-3", CONTRADICTION, _NOT_DIVIDED),
        Cell("latzel", ("0.486",), 2, "0", "3.49e-2", REPRODUCED),
        Cell("viteckova_2", ("0.639",), 2, "0", "8.42e-2", REPRODUCED),
    ),
    "S4": (
        Cell("latzel", ("0.501",), 5, "0", "1.23e-5", REPRODUCED),
        Cell("viteckova_2", ("0.838",), 2, "0.906", "7.83e-3", REPRODUCED),
        Cell(
            "harriott", ("0.437", "1.22"), 2, "0.906", "1.48e-2", CONTRADICTION,
            _RATIO.format("0.596"),
        ),
        Cell("viteckova_1", ("1.31",), 1, "1.37", "3.89e-2", REPRODUCED),
        Cell("sundaresan_krishnaswamy", ("1.14",), 1, "1.48", "4.92e-2", REPRODUCED),
        Cell("strejc", ("1.14",), 4, "0", "2.99e-1", CONTRADICTION, _COPIED.format("0.495")),
        Cell("smith", (), 0, "", "", NOT_SUITED, _BEYOND),
    ),
    "S5": (
        Cell("latzel", ("0.758",), 4, "0", "1.55e-3", REPRODUCED),
        Cell("viteckova_2", ("1.08",), 2, "0.913", "5.08e-3", REPRODUCED),
        Cell(
            "harriott", ("0.563", "1.57"), 2, "0.913", "1.28e-2", CONTRADICTION,
            _RATIO.format("0.585"),
        ),
        Cell("viteckova_1", ("1.69",), 1, "1.51", "3.85e-2", REPRODUCED),
        Cell("sundaresan_krishnaswamy", ("1.5",), 1, "1.64", "5.13e-2", REPRODUCED),
        Cell("strejc", ("1.5",), 4, "0", "4.77e-1", CONTRADICTION, _COPIED.format("0.560")),
        Cell("smith", (), 0, "", "", NOT_SUITED, _BEYOND),
    ),
}  # fmt: skip
"""Tables 4 to 8 by system, in the order of the paper: by its J."""

OTHER_J = (("S3", "viteckova_1"), ("S4", "strejc"), ("S5", "strejc"))
"""Cells whose printed J does not belong to the printed, misprinted model."""

LATZEL = (
    (2, "0.137", "1.880", "0.596", "0.257"),
    (2.5, "0.174", "1.245", "0.460", "0.216"),
    (3, "0.207", "0.907", "0.374", "0.188"),
    (4, "0.261", "0.573", "0.272", "0.150"),
    (5, "0.304", "0.411", "0.214", "0.125"),
    (6, "0.340", "0.317", "0.176", "0.108"),
    (7, "0.370", "0.257", "0.150", "0.095"),
    (8, "0.396", "0.215", "0.130", "0.085"),
    (9, "0.418", "0.184", "0.115", "0.077"),
    (10, "0.438", "0.161", "0.103", "0.070"),
    (11, "0.456", "0.142", "0.094", "0.065"),
    (12, "0.472", "0.128", "0.086", "0.060"),
    (13, "0.486", "0.116", "0.079", "0.056"),
    (14, "0.499", "0.106", "0.073", "0.053"),
    (15, "0.512", "0.097", "0.068", "0.050"),
    (16, "0.523", "0.090", "0.064", "0.047"),
    (17, "0.533", "0.084", "0.060", "0.045"),
    (18, "0.543", "0.078", "0.057", "0.042"),
    (19, "0.552", "0.073", "0.054", "0.040"),
    (20, "0.561", "0.069", "0.051", "0.039"),
)
"""Table 1: n, mu, alpha10, alpha50, alpha90."""
