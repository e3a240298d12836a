"""What moves the output beside the input, eliminated from a least-squares problem.

A linear drift, and the plant's own motion from a state other than rest, enter linearly: for given
shape and dead time their numbers are a regression (variable projection), and residuals lie across
all of them.
"""

from typing import NamedTuple

from jaxtyping import Array, Float

from .._arrays import Samples
from .._orthonormal import orthonormal


INDEPENDENT = 1e-6
"""Share of its length that a column must keep across those before it, to count as one of its own.

Nearly equal lags have nearly the same motions: what is left of them is rounding, and its numbers
would be huge. `test_own_motions_of_equal_lags` would notice."""


class Beside(NamedTuple):
    """Columns as orthonormal ones Q = C columns, in the inner product of the weights.

    Rows of Q and C are 0 for a column that those before it explain.
    """

    q: Float[Array, "k samples"]
    c: Float[Array, "k k"]
    weights: Samples

    @classmethod
    def of(cls, columns: list[Samples], weights: Samples) -> "Beside":
        """Of columns that are there, in their order."""
        q, c, _ = orthonormal(columns, weights, INDEPENDENT)
        return cls(q, c, weights)

    def across(self, row: Samples) -> Samples:
        """What of a row the columns do not explain."""
        return row - self.parts(row) @ self.q

    def parts(self, row: Samples) -> Float[Array, " k"]:
        """Numbers of the orthonormal columns in a row."""
        return self.q @ (self.weights * row)

    def numbers(self, row: Samples) -> Float[Array, " k"]:
        """Numbers of the columns themselves in a row."""
        return self.parts(row) @ self.c
