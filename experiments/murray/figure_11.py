"""Figure 11: error of every method against noise to 35 % on random plants, fits included.

100 noise levels with 100 plants of orders 2 to 8 each. The paper's figure shows one plant a level,
its error divided by 500 and the root taken of that; here it is the median over the plants.
"""

from experiments.murray.noise_study import draw, key_numbers, random_study
from experiments.murray.runner import Outcome, Settings, main


def run(settings: Settings) -> Outcome:
    levels, plants, old = settings.size(100, 12), settings.size(100, 20), settings.size(25, 5)
    frame = random_study(settings, "figure 11", 0.35, levels, plants, old)
    title = "Error against noise, random plants (Murray 2016, figure 11)"
    figure = draw(frame, title, 0.0, 0.021, (3e-4, 0.1))
    return Outcome(frame, figure, key_numbers(frame, (0.01, 0.1, 0.2, 0.34)))


if __name__ == "__main__":
    main(__file__)
