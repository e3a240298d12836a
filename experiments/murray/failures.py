"""Failure rate against order: refusals of the package, default values of the author's code.

The paper's figure of it shows 0 % everywhere, because its code counted neither.
"""

import pandas as pd

from experiments.drawing import new_figure
from experiments.murray.correct import FITS, lost
from experiments.murray.drawing import finish, line, order_axes
from experiments.murray.order_study import ORDERS, order_study, study
from experiments.murray.runner import Frame, Outcome, Settings, main


NOISE = 0.2
TITLES = {"legacy": "author's code: default values T = 1", "correct": "package: refused by status"}


def run(settings: Settings) -> Outcome:
    noisy = study(settings, "failures", NOISE, fits=False)
    frame: Frame = pd.concat([order_study(settings).assign(noise=0.0), noisy.assign(noise=NOISE)])
    frame["failed"] = lost(frame)
    columns = ["noise", "protocol", "method", "order"]
    rate = 100 * frame.groupby(columns).failed.mean().unstack("order")
    figure = new_figure((11, 8.5))
    panels = figure.subplots(2, 2, sharey=True)
    for line_of_panels, noise in zip(panels, (0.0, NOISE), strict=True):
        for axes, (protocol, title) in zip(line_of_panels, TITLES.items(), strict=True):
            for method, row in rate.loc[(noise, protocol)].iterrows():
                line(axes, str(method), row.index, row.values, markers=True)
            level = f"noise {100 * noise:.0f} % peak to peak" if noise else "no noise"
            order_axes(axes, f"{title}\n{level}")
        line_of_panels[0].set_ylabel("failed, % of the plants")
    panels[0, 0].set_ylim(-2, None)
    figure.suptitle("Failure rate against order (Murray 2016, appendix A.2.1)")
    finish(figure, panels.flat)
    numbers = {}
    for (noise, protocol), part in frame.groupby(["noise", "protocol"]):
        lookups = part[~part.method.isin(FITS)]
        key = f"{protocol}, noise {100 * noise:.0f} %"
        numbers[f"{key}: lookups failed, %"] = float(100 * lookups.failed.mean())
        at_two = lookups[lookups.order == ORDERS[0]]
        numbers[f"{key}: lookups failed at n = 2, %"] = float(100 * at_two.failed.mean())
    both = rate.loc[(NOISE, "correct")].mean(axis=1)
    for method in ("hudzovic_tu_tg", "hudzovic_t10_t50_t90", "hudzovic_fit", "sani_fit"):
        numbers[f"correct, noise 20 %: {method}, %"] = float(both[method])
    counts = frame.groupby(["noise", "protocol", "order", "method", "status", "failed"]).size()
    return Outcome(counts.rename("plants").reset_index(), figure, numbers)


if __name__ == "__main__":
    main(__file__)
