"""Array aliases used in signatures."""

from collections.abc import Sequence

from jaxtyping import Array, Bool, Complex, Float, Int


Scalar = Float[Array, ""]
"""One real number: a parameter, a time, a level."""
Flag = Bool[Array, ""]
"""One truth value."""
Count = Int[Array, ""]
"""One whole number."""
Samples = Float[Array, " samples"]
"""One value per sample of a record."""
Lags = Float[Array, " lags"]
"""Time constants of a chain of first-order lags; 0 is no lag."""
Spectrum = Complex[Array, "*shape"]
"""Complex frequency response."""
Coordinates = Array | Sequence[Array]
"""A few unknowns: a row, or numbers one by one."""
