"""What came of a study: a tidy table, and its summary."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._status import Status
from ._noise import shape_of
from ._store import Categories
from ._study import Study
from ._summary import summarised


if TYPE_CHECKING:
    import pandas as pd

STATUSES = tuple(Status._name_to_item)
"""Names of statuses by their number."""


class StudyResults:
    """Results of a study, or of those of its chunks that are finished.

    - `study`: the `Study`. `records`: numbers of the records that are there.
    - `rmse`, `status`: arrays (records, methods), in the order of the study's methods; the error is
        NaN where the method refused, the status a number (`stepax.Status`).
    """

    def __init__(self, study: Study, records: np.ndarray, rmse: np.ndarray, status: np.ndarray):
        self.study, self.records, self.rmse, self.status = study, records, rmse, status

    def __len__(self) -> int:
        return self.rmse.size

    def __repr__(self) -> str:
        of = "" if self.records.size == self.study.records else f" of {self.study.records:,}"
        methods = ", ".join(self.study.options)
        return f"StudyResults({self.records.size:,}{of} records, {methods})"

    @property
    def complete(self) -> bool:
        """Whether all records are there."""
        return self.records.size == self.study.records

    def to_frame(self) -> "pd.DataFrame":
        """One row a record and method, the same that a store holds.

        Columns `plant` (its number among those of its order), `order`, `noise` (the level),
        `noise_model`, `draw`, `method`, `rmse` (output units, over all samples, from the response
        without noise; NaN where refused) and `status` (names as in `Status`).
        """
        import pandas as pd

        columns = columns_of(self.study, self.records, (self.rmse, self.status))
        plain = {
            name: pd.Categorical.from_codes(x.codes, x.names) if isinstance(x, Categories) else x  # pyright: ignore[reportArgumentType]
            for name, x in columns.items()
        }
        return pd.DataFrame(plain)

    def summary(
        self,
        by: Sequence[str] = ("method", "order", "noise"),
        quantiles: Sequence[float] = (0.05, 0.25, 0.5, 0.75, 0.95),
        bootstrap: int = 200,
    ) -> "pd.DataFrame":
        """One row a group of results: errors, and what was refused.

        **Arguments:** `by`: columns of `to_frame()` that make the groups. `quantiles`: shares, each
        a column q05, q50, ...; `bootstrap`: samples with replacement of a group's *plants*,
        each with all its rows, from which the 95 % interval of the median comes (`median_low`,
        `median_high`); 0: none.

        **Returns:** `count`; `mean` and `rms` of the errors that there are; quantiles in which a
        refusal counts as worse than any result, so that they do not gain by it (inf: refused);
        `refused`, the share without a result; and the share of each status that occurs.
        """
        columns = columns_of(self.study, self.records, (self.rmse, self.status))
        return summarised(columns, by, quantiles, bootstrap)

    def plot(self, **options: Any):
        """Median error and refusals against the noise, a line a method, as a matplotlib figure."""
        from ._picture import draw

        return draw(self, **options)


def columns_of(study: Study, records: np.ndarray, found: Any) -> dict[str, Any]:
    """Columns of the table of some records."""
    rmse, status = found
    methods = list(study.options)
    method = np.tile(np.arange(len(methods), dtype=np.int8), records.size)
    order, plant, level, draw = (np.repeat(x, len(methods)) for x in study.places(records))
    levels = np.array([model.level for model in study.models])
    models = [shape_of(model) for model in study.models]
    names = list(dict.fromkeys(models))
    codes = np.array([names.index(name) for name in models], np.int8)
    return {
        "plant": plant.astype(np.int32),
        "order": np.array(study.orders, np.int8)[order],
        "noise": levels[level],
        "noise_model": Categories(codes[level], names),
        "draw": draw.astype(np.int32),
        "method": Categories(method, methods),
        "rmse": rmse.reshape(-1),
        "status": Categories(status.reshape(-1), list(STATUSES)),
    }
