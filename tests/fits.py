"""Plants, starts and simulated records that the tests of fits share."""

import equinox as eqx
import numpy as np

from stepax import (
    FOPDT,
    IPDT,
    SOPDT,
    EqualLag,
    Hudzovic,
    PTn,
    Sani,
    SOPDTZero,
    StepRecord,
    refine,
)
from stepax.records._record import predict


T = np.linspace(0.0, 60.0, 200)
STEP_TIME, STEP_SIZE = 4.0, 3.0
TRUE = {
    "FOPDT": FOPDT(T=8.0, gain=-2.0, offset=5.0, delay=3.3),
    "SOPDT": SOPDT(zeta=0.4, omega_n=0.5, gain=2.0, offset=5.0, delay=2.2),
    "Hudzovic": Hudzovic(T=3.0, r=0.2, n=4, gain=2.0, offset=5.0, delay=2.0),
    "Sani": Sani(T=8.0, r=0.6, n=3, gain=2.0, offset=5.0, delay=2.0),
    "EqualLag": EqualLag(T=4.0, n=2.5, gain=2.0, offset=5.0, delay=1.0),
    "PTn": PTn(lags=[8.0, 2.0], gain=2.0, offset=5.0, delay=2.0),
    "SOPDTZero": SOPDTZero(zeta=0.7, omega_n=0.4, lead=-3.0, gain=2.0, offset=5.0, delay=2.2),
    "IPDT": IPDT(T=6.0, gain=0.1, offset=5.0, delay=3.0),
}
START = {
    "FOPDT": FOPDT(T=5.0, delay=4.5),
    "SOPDT": SOPDT(zeta=0.8, omega_n=0.3, delay=1.0),
    "Hudzovic": Hudzovic(T=5.0, r=0.1, n=4, delay=1.0),
    "Sani": Sani(T=6.0, r=0.8, n=3, delay=1.0),
    "EqualLag": EqualLag(T=6.0, n=2.0, delay=0.5),
    "PTn": PTn(lags=[6.0, 3.0], delay=1.0),
    "SOPDTZero": SOPDTZero(zeta=0.8, omega_n=0.3, lead=-2.0, delay=1.0),
    "IPDT": IPDT(T=8.0, delay=1.0),
}
COMPILED = eqx.filter_jit(refine)


def simulated(plant, noise=0.0, seed=0, dtype=np.float64, **levels):
    clean = np.asarray(predict(plant, StepRecord(T, T, STEP_TIME, STEP_SIZE), T))
    y = clean + noise * np.random.default_rng(seed).standard_normal(T.size)
    return StepRecord(T.astype(dtype), y.astype(dtype), STEP_TIME, STEP_SIZE, **levels)
