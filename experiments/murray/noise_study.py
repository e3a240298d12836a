"""Error against noise: what figures 10, 11 and 12 share.

Noise is uniform, `noise` peak to peak. Lookups smooth with LOESS over 20 % of the record, fits do
not. In both protocols the error is the distance from the response without noise.
"""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.drawing import new_figure
from experiments.murray import correct, legacy
from experiments.murray.drawing import LOOKS, finish, line
from experiments.murray.plants import PT4_LAGS, padded, random_lags, record_times
from experiments.murray.runner import Frame, Settings
from stepax import sliding_average


COLUMNS = ["protocol", "noise", "method", "rmse", "status"]
TITLES = {"legacy": "author's code", "correct": "exact curves, known levels"}
FAILED = {"legacy": "default values T = 1, %", "correct": "refused by status, %"}


def pt4_study(settings: Settings, name: str, top: float, levels: int, old: int) -> Frame:
    """The plant of figures 10 and 12 at `levels` noise levels from 0 to `top`, one draw each.

    The legacy code runs on `old` of the same records, in which it does not know the gain.
    """
    t, clean = legacy.pt4_record()
    noise = np.linspace(0, top, levels)
    added = noise[:, None] * (settings.generator(name).random((levels, t.size)) - 0.5)
    lags = np.broadcast_to(padded(PT4_LAGS), (levels, 8))
    found = correct.errors(lags, np.broadcast_to(t, added.shape), added)
    chosen = np.linspace(0, levels - 1, old).astype(int)
    rows = [(noise[k], *row) for k in chosen for row in legacy.errors(t, clean, added[k])]
    return _frame(found, noise, rows)


def random_study(
    settings: Settings, name: str, top: float, levels: int, plants: int, old: int
) -> Frame:
    """Random plants of random order, `plants` at each of `levels` noise levels from 0 to `top`.

    The legacy code runs on `old` other plants at each level, on its own sampling.
    """
    generator = settings.generator(name)
    noise = np.repeat(np.linspace(0, top, levels), plants)
    lags = _any_order(generator, noise.size)
    t = record_times(lags)
    added = noise[:, None] * (generator.random(t.shape) - 0.5)
    found = correct.errors(lags, t, added)
    rows = []
    for level in np.repeat(np.linspace(0, top, levels), old):
        t_old, clean = legacy.simulated(_any_order(generator, 1)[0])
        added = level * (generator.random(t_old.size) - 0.5)
        rows += [(level, *row) for row in legacy.errors(t_old, clean, added)]
    return _frame(found, noise, rows)


def _any_order(generator, count):
    return np.concatenate(
        [random_lags(generator, 1, n) for n in generator.integers(2, 9, count)]
    )  # fmt: skip


def _frame(found, noise, rows) -> Frame:
    found = found.assign(protocol="correct", noise=noise[found.plant])
    old = pd.DataFrame(rows, columns=["noise", "method", "rmse", "status", "n", "T", "r"])
    return pd.concat([old.assign(protocol="legacy")[COLUMNS], found[COLUMNS]])


def ranked(frame: Frame) -> Frame:
    """RMSE with refusals as infinite, so that a median counts them as worse than any result.

    Default values of the legacy code keep their error, as in the paper.
    """
    return frame.rmse.fillna(np.inf)


def near(frame: Frame, noise: float, width: float = 0.01) -> Frame:
    """Rows within `width` of a noise level, or at the nearest one that was run."""
    distance = (frame.noise - noise).abs()
    nearest = distance.groupby(frame.protocol).transform("min")
    return frame[distance <= nearest.clip(lower=width) + 1e-12]


def medians(frame: Frame, noise: float) -> Frame:
    """Median RMSE by protocol and method within 1 % of a noise level; refusals are worst."""
    part = near(frame, noise)
    return ranked(part).groupby([part.protocol, part.method]).median()


def failure_rates(frame: Frame, noise: float) -> Frame:
    """Per cent of refusals or default values, by protocol and method, within 1 % of a level."""
    part = near(frame, noise)
    return 100 * correct.lost(part).groupby([part.protocol, part.method]).mean()


def curve(part: Frame, half: float, share: float):
    """Noise levels, running median of the RMSE over +-`half`, and running rate of failures.

    The median is smoothed by a sliding average over a share of the levels, as the paper smoothed
    its errors. It ends where half of the results are refused.
    """
    levels = np.unique(part.noise)
    part = part.sort_values("noise")
    noise, values, failed = part.noise.values, ranked(part).values, correct.lost(part).values
    first = np.searchsorted(noise, levels - half - 1e-12)
    last = np.searchsorted(noise, levels + half + 1e-12)
    windows = [slice(a, b) for a, b in zip(first, last, strict=True)]
    middle = np.array([np.median(values[w]) for w in windows])
    rate = np.array([100 * np.mean(failed[w]) for w in windows])
    width = max(3, round(share * levels.size))
    smooth = sliding_average(np.where(np.isfinite(middle), middle, np.nan), width)
    return levels, np.asarray(smooth), rate


def draw(frame: Frame, title: str, half: float, share: float, limits) -> Figure:
    """Error above, failures below; the author's code on the left, the package on the right."""
    figure = new_figure((12, 9))
    panels = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=[2.2, 1])
    for column, protocol in zip(panels.T, TITLES, strict=True):
        error, failed = column
        for method in (*correct.LOOKUPS, *correct.FITS):
            part = frame[(frame.protocol == protocol) & (frame.method == method)]
            noise, median, rate = curve(part, half, share)
            line(error, method, 100 * noise, median, linewidth=1.5)
            line(failed, method, 100 * noise, rate, linewidth=1.5)
        error.set(title=TITLES[protocol], yscale="log", ylim=limits)
        failed.set(xlabel="noise, peak to peak, % of the step", ylabel=FAILED[protocol])
    window = f"median within ±{100 * half:.2g} % noise" if half else "median over the plants"
    average = f"sliding average over {100 * share:.2g} % of the axis"
    panels[0, 0].set_ylabel(f"RMSE, {window},\n{average}")
    figure.suptitle(f"{title}\nA refusal counts as worse than any result", fontsize=12)
    finish(figure, panels.flat)
    return figure


def key_numbers(frame: Frame, levels) -> dict[str, str | float]:
    """Medians and failures of the package at some noise levels."""
    numbers: dict[str, str | float] = {}
    for level in levels:
        middle, rate = medians(frame, level)["correct"], failure_rates(frame, level)["correct"]
        numbers[f"median RMSE at {100 * level:.0f} % noise"] = ", ".join(
            f"{LOOKS[method].label} {middle[method]:.4f}"
            + (f" ({rate[method]:.0f} % refused)" if rate[method] > 0.5 else "")
            for method in (*correct.LOOKUPS, *correct.FITS)
        )
    return numbers
