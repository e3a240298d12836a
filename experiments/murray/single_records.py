"""All methods on one perfect and on one noisy record, with T, r, n and RMSE (A.2.9, A.2.8).

Perfect: Hudzovic's chain with T = 1, r = 0.1, n = 2. Noisy: that with T = 1, r = 1/6, n = 4 and
uniform noise of 20 % peak to peak. (The paper's listing of the noisy one has the noise set to 0.)
Both go from 22 to 37 degrees, as in the paper; RMSE is that from the response without noise.
"""

import pandas as pd

from experiments.drawing import new_figure
from experiments.murray import correct
from experiments.murray.drawing import LOOKS, finish, line
from experiments.murray.plants import PT4_LAGS, padded, record_times
from experiments.murray.runner import Frame, Outcome, Settings, main
from experiments.numpy_responses import chain_lags
from stepax import Hudzovic, PTn, Sani, smooth


OFFSET, SPAN_OF_OUTPUT, NOISE = 22.0, 15.0, 0.2
TITLES = {
    "perfect": "Hudzovic T = 1, r = 0.1, n = 2, no noise",
    "noisy": "Hudzovic T = 1, r = 1/6, n = 4, noise 20 % peak to peak",
}
RECORDS = {"perfect": chain_lags(Hudzovic, 1.0, 0.1, 2), "noisy": PT4_LAGS}


def run(settings: Settings) -> Outcome:
    figure = new_figure((12, 9))
    panels = figure.subplots(2, 2, sharex="col", height_ratios=[2, 1])
    frames = []
    for column, (title, lags) in zip(panels.T, RECORDS.items(), strict=True):
        t = record_times(lags)
        noise = NOISE * (settings.generator("single records").random(t.size) - 0.5)
        added = None if title == "perfect" else noise[None]
        found = correct.errors(padded(lags)[None], t[None], added)
        found["rmse"] *= SPAN_OF_OUTPUT
        frames.append(found.assign(record=title))
        clean = PTn(lags=lags, gain=SPAN_OF_OUTPUT, offset=OFFSET).step_response(t)
        response, error = column
        y = clean + SPAN_OF_OUTPUT * (0 if added is None else added[0])
        response.plot(t, y, ".", color="0.7", markersize=4, label="record")
        if added is not None:
            look = {"color": "0.35", "linewidth": 1, "label": "record, LOESS over 20 %"}
            response.plot(t, smooth(t, y, correct.SPAN), **look)
        for row in found[~correct.lost(found)].to_dict("records"):
            method = row["method"]
            family = Hudzovic if method.startswith("hudzovic") else Sani
            own = {name: row[name] for name in ("T", "r", "n")}
            model = family(**own, gain=SPAN_OF_OUTPUT, offset=OFFSET)
            modelled = model.step_response(t)
            line(response, method, t, modelled, linewidth=1.4)
            line(error, method, t, modelled - clean, linewidth=1.2)
        response.set(title=TITLES[title], ylabel="temperature, °C")
        error.set(xlabel="time", ylabel="model - clean response, °C")
    figure.suptitle("All methods on one record (Murray 2016, A.2.8 and A.2.9)")
    finish(figure, panels.flat, columns=5)
    frame: Frame = pd.concat(frames)[["record", "method", "n", "T", "r", "rmse", "status"]]
    numbers = {
        "{record}, {label}".format(**row, label=LOOKS[row["method"]].label): (
            "n {n}, T {T:.4f}, r {r:.4f}, RMSE {rmse:.2e} °C, {status}".format(**row)
        )
        for row in frame.to_dict("records")
    }
    return Outcome(frame, figure, numbers)


if __name__ == "__main__":
    main(__file__)
