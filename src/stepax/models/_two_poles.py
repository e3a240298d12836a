"""Plants with two poles and dead time; a zero beside them, or one of them an integrator."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Complex, Float, Shaped

from .._arrays import Flag, Lags, Samples, Scalar, as_real, safe_sqrt
from ._abstract import (
    RATE,
    SETTLED,
    SLOPE,
    TIME,
    AbstractPlant,
    Factor,
    TimeScales,
)
from ._contour import Slopes
from ._free import free_positive, positive
from ._realisation import AbstractRealisation, ChainRealisation, SecondOrderRealisation
from ._responses import (
    first_order_response,
    lagged_ramp_response,
    second_order_response,
    second_order_slopes,
    second_order_zero_response,
)


class SOPDT(AbstractPlant):
    r"""Second order plus dead time: $\omega_n^2/(s^2 + 2\zeta\omega_n s + \omega_n^2)$.

    Source: A. Maxim, R. De Keyser. `zeta` is the damping, any zeta > 0; `omega_n` the undamped
    natural frequency in radian per unit of time, > 0. Smooth through zeta = 1.
    """

    zeta: Float[Array, "..."] = eqx.field(converter=as_real)
    omega_n: Float[Array, "..."] = eqx.field(converter=as_real, metadata=RATE)

    def own_in_range(self) -> Any:
        """zeta > 0 and omega_n > 0."""
        return (self.zeta > 0) & (self.omega_n > 0)

    def own_to_free(self) -> dict[str, Array]:
        """Damping and period."""
        period = jnp.sqrt(1 + 4 * self.zeta**2) / self.omega_n
        return {"zeta": free_positive(self.zeta), "omega_n": free_positive(period)}

    def own_from_free(self) -> dict[str, Array]:
        """zeta and omega_n."""
        zeta = positive(self.zeta)
        return {"zeta": zeta, "omega_n": jnp.sqrt(1 + 4 * zeta**2) / positive(self.omega_n)}

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), in closed form."""
        return second_order_response(t, self.zeta, self.omega_n)

    def slopes(self, t: Samples, changes: Sequence[dict[str, Array]]) -> Slopes:
        """All from the same exponentials."""
        return second_order_slopes(
            t, self.zeta, self.omega_n, jnp.zeros_like(self.zeta), _second_order(self, changes)
        )

    def own_motions(self, t: Samples) -> list[Samples]:
        """1 - g, and the slope of g over omega_n."""
        g, slope = jax.jvp(self.unit_response, (t,), (jnp.ones_like(t),))
        return [1 - g, slope / self.omega_n]

    def realise(self, interval: Scalar) -> AbstractRealisation:
        """The output and its slope."""
        del interval
        return SecondOrderRealisation(self.zeta, self.omega_n, jnp.zeros_like(self.zeta))

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s)."""
        x = s / self.omega_n
        return 1 / (1 + x * (2 * self.zeta + x))

    @property
    def lags(self) -> Lags:
        """Both time constants of an overdamped model, descending.

        One that oscillates has none: `ValueError`; traced, NaN.
        """
        if not isinstance(self.zeta, Tracer) and not float(self.zeta) >= 1:
            raise ValueError(f"SOPDT with damping zeta = {self.zeta} < 1 has no real lags.")
        excess = (self.zeta - 1) * (self.zeta + 1)
        slow = (self.zeta + safe_sqrt(jnp.where(self.zeta >= 1, excess, jnp.nan))) / self.omega_n
        return jnp.stack([slow, 1 / (slow * self.omega_n**2)])

    @property
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """The two poles, complex for zeta < 1. Needs concrete parameters."""
        zeta, omega_n = np.asarray(self.zeta), np.asarray(self.omega_n)
        if zeta >= 1:
            return -1 / np.asarray(self.lags)
        damped = omega_n * np.sqrt((1 - zeta) * (1 + zeta))
        return np.array([-zeta * omega_n + 1j * damped, -zeta * omega_n - 1j * damped])

    def denominator(self) -> list[Factor]:
        """One quadratic factor where it oscillates, else two lags."""
        zeta, omega_n = float(np.asarray(self.zeta)), float(np.asarray(self.omega_n))
        if zeta < 1:
            return [Factor((1.0, 2 * zeta / omega_n, omega_n**-2))]
        return [Factor((1.0, lag)) for lag in np.asarray(self.lags, float).tolist()]

    def time_scales(self) -> TimeScales:
        """Of an oscillation its period over 2 pi and its decay, else of the two lags."""
        if float(self.zeta) < 1:
            fast = 1 / float(self.omega_n)
            return TimeScales(fast, fast, 40 * fast / float(self.zeta))
        slow, fast = np.asarray(self.lags, float).tolist()
        return TimeScales(fast, slow, 40 * slow + 10 * (slow + fast))


class SOPDTZero(AbstractPlant):
    r"""Second order with one zero: $(1 + s\,\text{lead})$ times the transfer function of `SOPDT`.

    Source: the "Z" of process models (L. Ljung, System Identification Toolbox). `zeta` and
    `omega_n` as in `SOPDT`. `lead`, unit of time, of either sign: a negative one moves the output
    the wrong way first (inverse response), one above the larger lag makes it overshoot without
    oscillation; 0 is `SOPDT`. The response has a corner where the dead time ends.
    """

    zeta: Float[Array, "..."] = eqx.field(converter=as_real)
    omega_n: Float[Array, "..."] = eqx.field(converter=as_real, metadata=RATE)
    lead: Float[Array, "..."] = eqx.field(converter=as_real, metadata=TIME)

    @property
    def _without_zero(self) -> SOPDT:
        return SOPDT(zeta=self.zeta, omega_n=self.omega_n)

    def own_in_range(self) -> Any:
        """As in `SOPDT`; a lead of either sign."""
        return self._without_zero.own_in_range() & jnp.isfinite(self.lead)

    def own_to_free(self) -> dict[str, Array]:
        """As in `SOPDT`, and lead over period."""
        period = jnp.sqrt(1 + 4 * self.zeta**2) / self.omega_n
        return self._without_zero.own_to_free() | {"lead": self.lead / period}

    def own_from_free(self) -> dict[str, Array]:
        """zeta, omega_n and lead."""
        own = self._without_zero.own_from_free()
        return own | {"lead": self.lead * positive(self.omega_n)}

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), in closed form."""
        return second_order_zero_response(t, self.zeta, self.omega_n, self.lead)

    def slopes(self, t: Samples, changes: Sequence[dict[str, Array]]) -> Slopes:
        """All from the same exponentials."""
        return second_order_slopes(
            t, self.zeta, self.omega_n, self.lead, _second_order(self, changes)
        )

    def own_motions(self, t: Samples) -> list[Samples]:
        """As without the zero."""
        return self._without_zero.own_motions(t)

    def realise(self, interval: Scalar) -> AbstractRealisation:
        """The output and its slope."""
        del interval
        return SecondOrderRealisation(self.zeta, self.omega_n, self.lead)

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s)."""
        return (1 + s * self.lead) * self._without_zero.unit_transfer_function(s)

    @property
    def lags(self) -> Lags:
        """Both time constants where it does not oscillate, as in `SOPDT`."""
        return self._without_zero.lags

    @property
    def zeros(self) -> Shaped[np.ndarray, " m"]:
        """-1/lead; none for a lead of 0."""
        lead = np.atleast_1d(np.asarray(self.lead))
        return -1 / lead[lead != 0]

    @property
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """The two poles, complex for zeta < 1."""
        return self._without_zero.poles

    def numerator(self) -> list[Factor]:
        """1 + s lead."""
        lead = float(np.asarray(self.lead))
        return [Factor((1.0, lead))] if lead else []

    def denominator(self) -> list[Factor]:
        """As in `SOPDT`."""
        return self._without_zero.denominator()

    def time_scales(self) -> TimeScales:
        """As in `SOPDT`."""
        return self._without_zero.time_scales()

    def has_settled(self, last: Scalar) -> Flag:
        """It may come from above."""
        return jnp.abs(last - 1) <= 1 - SETTLED


class IPDT(AbstractPlant):
    r"""Integrating with one lag: $1/(s (1 + sT))$; its response ends as a ramp.

    Source: the "I" of process models (L. Ljung, System Identification Toolbox). T >= 0 in units of
    time (0: no lag; negative: NaN). `gain` is the slope of the output per unit of input: after a
    step of the input the output moves by gain times the size of the step in every unit of time. The
    static gain is infinite; the frequency response at 0 is inf + nan j, as in python-control.
    """

    settles = False

    gain: Float[Array, "..."] = eqx.field(
        converter=as_real, default=1.0, kw_only=True, metadata=SLOPE
    )
    T: Float[Array, "..."] = eqx.field(converter=as_real, metadata=TIME)

    def own_in_range(self) -> Any:
        """T >= 0."""
        return self.T >= 0

    def own_to_free(self) -> dict[str, Array]:
        """T."""
        return {"T": free_positive(self.T)}

    def own_from_free(self) -> dict[str, Array]:
        """T."""
        return {"T": positive(self.T)}

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), in closed form."""
        return lagged_ramp_response(t, self.T)

    def own_motions(self, t: Samples) -> list[Samples]:
        """That of the lag."""
        one = jnp.where(self.T > 0, self.T, 1)
        return [jnp.where(self.T > 0, 1 - first_order_response(t, one), 0)]

    def realise(self, interval: Scalar) -> AbstractRealisation:
        """The integral of the input, and the lag behind it."""
        return ChainRealisation(self.lags, interval, integrators=1)

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s); at 0, where a complex division would give NaN, its real part is infinite."""
        away = s != 0
        return jnp.where(away, 1 / (jnp.where(away, s, 1) * (1 + s * self.T)), jnp.inf)

    @property
    def static_gain(self) -> Scalar:
        """Infinite, with the sign of the gain."""
        return self.gain * jnp.inf

    @property
    def lags(self) -> Lags:
        """The one time constant beside the integrator."""
        return jnp.reshape(self.T, (1,))

    @property
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """0 and -1/T; a lag of 0 has none."""
        T = np.atleast_1d(np.asarray(self.T))
        return np.concatenate([[0.0], -1 / T[T != 0]])

    def denominator(self) -> list[Factor]:
        """s, and 1 + sT."""
        T = float(np.asarray(self.T))
        return [Factor((0.0, 1.0)), *([Factor((1.0, T))] if T else [])]

    def time_scales(self) -> TimeScales:
        """Of the lag; it never comes to rest."""
        T = float(np.asarray(self.T))
        return TimeScales(T, T, np.inf)

    def has_settled(self, last: Scalar) -> Flag:
        """Its gain is a slope, which any row shows."""
        return jnp.ones_like(last, bool)


def _second_order(
    plant: SOPDT | SOPDTZero, changes: Sequence[dict[str, Array]]
) -> list[tuple[Scalar, Scalar, Scalar]]:
    """Changes of zeta, omega_n and lead."""
    still = jnp.zeros_like(plant.zeta)
    return [tuple(x.get(k, still) for k in ("zeta", "omega_n", "lead")) for x in changes]  # pyright: ignore[reportReturnType]
