"""The heater of section 3.1, read from its picture by the author's rule and by the package.

Author's rule (A.1.6, A.2.7): all pixels whose hue is within 0.1 of the first coloured pixel's,
column by column, every tenth of them; times evenly spaced over them all, the first ten and the last
eleven as levels; no units but by hand. The package has one value per column on calibrated axes.
Both are held against points traced by hand, and the models that follow against each other.

The picture is not part of this folder; without it there is nothing to compute.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.colors import rgb_to_hsv
from matplotlib.image import imread

from experiments.drawing import new_figure
from experiments.murray import legacy
from experiments.murray.drawing import LOOKS, finish, line, rms
from experiments.murray.runner import Frame, Outcome, Settings, main
from stepax import identify, sliding_average, trace_image


PICTURE = Path(__file__).parents[3] / "shared/data/heater_plot.png"

BY_HAND = np.array([
    (75, 457), (118, 441), (132, 423), (138, 417), (157, 389), (186, 337), (192.5, 322),
    (215.5, 275), (241.5, 234), (258, 213.7), (271, 190), (285.5, 173), (294.5, 164), (317, 133),
    (348.5, 113), (422, 79), (472, 67), (524, 68), (584, 63), (651, 66),
])  # fmt: skip
"""Column and row of the middle of the stroke, read by eye off the picture enlarged fourteen times,
where it can be told to half a pixel; the upper left pixel is (0, 0)."""

LEFT, RIGHT, TOP, BOTTOM = 63.0, 670.0, 34.0, 514.0
"""Pixels of the frame, which are 0 s, 10 s, 38 and 20 degrees."""

DURATION, OFFSET, CHANGE, DECIMATION = 10.0, 22.0, 15.0, 10


def by_the_author(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and values, both from 0 to 1, of `import_curve_from_image` and the script after it.

    MATLAB goes through a picture column by column.
    """
    columns = np.swapaxes(picture, 0, 1)
    coloured = np.any(columns != columns[..., :1], axis=-1)
    hue = rgb_to_hsv(columns / 255)[..., 0]
    key = hue[coloured][0]
    row = np.nonzero((hue > key - 0.1) & (hue < key + 0.1))[1]
    y = -row[::DECIMATION].astype(float)
    low, high = np.mean(y[:10]), np.mean(y[-11:])
    return np.linspace(0, 1, y.size), (y - low) / (high - low)


def hand_points() -> tuple[np.ndarray, np.ndarray]:
    """Times and degrees of the points traced by hand."""
    x, y = BY_HAND.T
    t = DURATION * (x - LEFT) / (RIGHT - LEFT)
    return t, 38 - 18 * (y - TOP) / (BOTTOM - TOP)


def author_models(t, y) -> dict[str, legacy.Model]:
    """Models of the author's script, whose unit of time is the duration of the record."""
    smoothed = np.asarray(sliding_average(y, int(np.ceil(0.08 * y.size))))
    return legacy.identify(DURATION * t, y, smoothed)


def run(settings: Settings) -> Outcome:
    if not PICTURE.exists():
        return Outcome(pd.DataFrame(), None, {"heater_plot.png": "not here, nothing computed"})
    picture = np.rint(255 * imread(PICTURE)[..., :3]).astype(int)
    share, height = by_the_author(picture)
    t_his, y_his = DURATION * share, OFFSET + CHANGE * height
    record = trace_image(PICTURE, x_range=(0, DURATION), y_range=(20, 38))
    t, y = np.asarray(record.t), np.asarray(record.y)
    t_hand, y_hand = hand_points()
    rows, numbers = [], {}
    readings = {"author's rule": (t_his, y_his), "one value a column": (t, y)}
    figure = new_figure((12, 8.5))
    panels = figure.subplots(2, 2, sharex=True, height_ratios=[2, 1])
    for column, (name, (times, values)) in zip(panels.T, readings.items(), strict=True):
        off = np.interp(t_hand, times, values) - y_hand
        numbers[f"{name}: rms from the points traced by hand, °C"] = rms(off)
        response, distance = column
        response.plot(times, values, ".", color="0.65", markersize=3, label="as read")
        response.plot(t_hand, y_hand, "o", color="0.1", mfc="none", label="traced by hand")
        distance.axhline(0, color="0.6", linewidth=0.8)
        response.set(title=name, ylabel="temperature, °C")
        distance.set(xlabel="time, s", ylabel="model - as read, °C")
    his, ours = panels.T
    for method, model in author_models(share, height).items():
        modelled = OFFSET + CHANGE * model.response(t_his)
        row = {"reading": "author", "method": method, "n": model.n, "T": model.T, "r": model.r}
        rows.append(row | {"rms": rms(modelled - y_his)})
        line(his[0], method, t_his, modelled, linewidth=1.3)
        line(his[1], method, t_his, modelled - y_his, linewidth=0.8)
    for method in ("hudzovic_fit", "sani_fit"):
        result = identify(record, method)
        model, modelled = result.model, np.asarray(result.predict(t))
        row = {"reading": "package", "method": method, "n": int(model.n), "T": float(model.T)}
        rows.append(row | {"r": float(model.r), "rms": float(result.rmse)})
        line(ours[0], method, t, modelled, linewidth=1.3)
        line(ours[1], method, t, modelled - y, linewidth=0.8)
    figure.suptitle("The heater from its picture (Murray 2016, section 3.1)")
    finish(figure, panels.flat, columns=5)
    frame: Frame = pd.DataFrame(rows)
    numbers["points"] = f"author {t_his.size}, package {t.size}"
    for row in rows:
        name = f"{row['reading']}, {LOOKS[row['method']].label}"
        numbers[name] = "n {n}, T {T:.4f} s, r {r:.4f}, rms {rms:.3f} °C".format(**row)
    return Outcome(frame, figure, numbers)


if __name__ == "__main__":
    main(__file__)
