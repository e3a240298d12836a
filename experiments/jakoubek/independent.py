"""The correct cells of tables 4 to 8, computed without stepax.

Exact crossing times (incomplete gamma function, partial fractions, root finding), the printed
constants of the paper with its misprints set right, gain 2; five digits. No values where the method
does not apply. (Strejc on S5 with y_i = 0.353; the paper's misprint 0.359 gives T = 0.75862 and
J = 2.0538e-3.)
"""

from typing import NamedTuple


class Correct(NamedTuple):
    """Lags (one stands for all `order`) and dead time in seconds, J in (output unit)^2 s."""

    lags: tuple[float, ...] = ()
    order: int = 0
    delay: float = 0.0
    J: float = float("nan")


CORRECT = {
    "S1": {
        "viteckova_1": Correct((0.50018,), 1, 0.00016847, 2.9372171e-07),
        "viteckova_2": Correct((0.31899,), 2, 0, 0.085827138),
        "latzel": Correct((0.20049,), 2, 0, 0.040409742),
        "harriott": Correct((0.50359,), 1, 0, 2.5680246e-05),
        "smith": Correct((0.5,), 1, 0, 0),
        "strejc": Correct((0.50659,), 1, 0, 8.6353222e-05),
        "sundaresan_krishnaswamy": Correct((0.49644,), 1, 0.005004, 5.4117173e-05),
    },
    "S2": {
        "viteckova_1": Correct((0.78409,), 1, 0.27618, 0.0084936399),
        "viteckova_2": Correct((0.50005,), 2, 0, 1.7398122e-08),
        "latzel": Correct((0.49996,), 2, 0, 9.7035878e-09),
        "harriott": Correct((0.49741,), 2, 0, 4.0460978e-05),
        "smith": Correct((0.5,), 2, 0, 0),
        "strejc": Correct((0.58263, 0.42658), 2, 0, 0.00010743056),
        "sundaresan_krishnaswamy": Correct((0.72199,), 1, 0.31541, 0.011565924),
    },
    "S3": {
        "viteckova_1": Correct((1.0017,), 1, 0.1041, 0.00041307878),
        "viteckova_2": Correct((0.63882,), 2, 0, 0.083961856),
        "latzel": Correct((0.48582,), 2, 0, 0.034711479),
        "harriott": Correct((0.98007, 0.10816), 2, 0, 0.00016512334),
        "smith": Correct((1.0, 0.1), 2, 0, 0),
        "strejc": Correct((0.9958, 0.10124), 2, 0, 9.118983e-06),
        "sundaresan_krishnaswamy": Correct((0.9934,), 1, 0.11541, 0.00080947568),
    },
    "S4": {
        "viteckova_1": Correct((1.3082,), 1, 1.3712, 0.038840597),
        "viteckova_2": Correct((0.83428,), 2, 0.90992, 0.0078065031),
        "latzel": Correct((0.49976,), 5, 0, 1.4019113e-06),
        "harriott": Correct((0.99123, 0.66063), 2, 0.90992, 0.0078771581),
        "smith": Correct(),
        "strejc": Correct((0.4999,), 5, 0, 2.6790752e-07),
        "sundaresan_krishnaswamy": Correct((1.1381,), 1, 1.4804, 0.048980618),
    },
    "S5": {
        "viteckova_1": Correct((1.6882,), 1, 1.5075, 0.038580035),
        "viteckova_2": Correct((1.0767,), 2, 0.91218, 0.0050351638),
        "latzel": Correct((0.7566,), 4, 0, 0.0015810377),
        "harriott": Correct((1.2383, 0.89727), 2, 0.91218, 0.0050093988),
        "smith": Correct(),
        "strejc": Correct((0.7522,), 4, 0, 0.00088309025),
        "sundaresan_krishnaswamy": Correct((1.5007,), 1, 1.6296, 0.05026335),
    },
}
"""By system and method."""
