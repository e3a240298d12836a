"""Figure 12: error of every method against noise to 200 % on one plant of order 4.

As figure 10, at 10 000 noise levels; the author's code runs on a quarter of the records.
"""

from experiments.murray.noise_study import draw, key_numbers, pt4_study
from experiments.murray.runner import Outcome, Settings, main


def run(settings: Settings) -> Outcome:
    levels, old = settings.size(10_000, 400), settings.size(2500, 100)
    frame = pt4_study(settings, "figure 12", 2.0, levels, old)
    title = "Error against noise, PT4 plant, long view (Murray 2016, figure 12)"
    figure = draw(frame, title, settings.size(2, 3) / 100, 0.0031, (1e-4, 1.0))
    return Outcome(frame, figure, key_numbers(frame, (0.01, 0.2, 0.35, 0.5, 1.0, 1.99)))


if __name__ == "__main__":
    main(__file__)
