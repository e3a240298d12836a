"""Units in the names of columns, and those of parameters."""

import pytest

from stepax import IPDT, SOPDT, EqualLag, PTn
from stepax.records._labels import Labels, Units, unit_of


LABELS = Labels("oven.csv", "time (s)", "T [degC]", "heater (%)")


@pytest.mark.parametrize(
    ("label", "unit"),
    [
        ("Velocidad (rad/s)", "rad/s"),
        ("T1 [°C]", "°C"),
        ("T (box) [K]", "K"),
        ("[K]", ""),
        ("T [1]", ""),
        ("time_s", "s"),
        ("Temp, degC", "degC"),
        ("T_1", ""),
        ("y(t)", ""),
        ("box temp", ""),
        ("", ""),
    ],
)
def test_unit(label, unit):
    assert unit_of(label) == unit


def test_units_of_parameters():
    units = Units.of(LABELS)
    chain, pair, oscillation = EqualLag(T=1.0, n=2.5), PTn(lags=[1.0]), SOPDT(zeta=1.0, omega_n=1.0)
    owners = [(chain, "T"), (pair, "lags"), (chain, "delay"), (chain, "gain"), (chain, "offset")]
    owners += [(oscillation, "zeta"), (oscillation, "omega_n"), (chain, "n")]
    expected = ["s", "s", "s", "degC/%", "degC", "", "rad/s", ""]
    assert [units.unit(model.dimension(name)) for model, name in owners] == expected
    assert units.unit(IPDT(T=1.0).dimension("gain")) == "degC/(% s)"
    assert units.integral == "degC^2 s"
    assert Units.of(Labels()).unit(chain.dimension("gain")) == ""
    assert Units("s", "rad/s", "V").unit(chain.dimension("gain")) == "(rad/s)/V"


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        (Units("s", "degC", "%"), ["s", "rad/s", "", "degC/%", "degC", "degC/(% s)"]),
        (
            Units("min", "rad/s", "l/min"),
            ["min", "rad/min", "", "(rad/s)/(l/min)", "rad/s", "(rad/s)/((l/min) min)"],
        ),
        (
            Units("s", "degC", ""),
            ["s", "rad/s", "", "degC per unit of input", "degC", "degC/s per unit of input"],
        ),
        (Units("", "degC", "%"), ["", "", "", "degC/%", "degC", ""]),
        (Units("s", "", "%"), ["s", "rad/s", "", "", "", ""]),
        (Units("", "", ""), [""] * 6),
    ],
)
def test_units_of_dimensions(units, expected):
    dimensions = ["time", "per time", "1", "output/input", "output", "output/(input time)"]
    assert [units.unit(dimension) for dimension in dimensions] == expected
    with pytest.raises(KeyError):
        units.unit("length")
