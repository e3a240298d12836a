"""Figure 10: error of every method against noise to 35 % on one plant of order 4.

The plant is Hudzovic's chain with T = 1, r = 1/6, n = 4 on the author's 253 samples. The paper's
figure shows squared errors in square degrees under the label RMSE; here it is RMSE, of gain 1.
"""

from experiments.murray.noise_study import draw, key_numbers, pt4_study
from experiments.murray.runner import Outcome, Settings, main


def run(settings: Settings) -> Outcome:
    frame = pt4_study(
        settings, "figure 10", 0.35, settings.size(1000, 100), settings.size(1000, 100)
    )
    title = "Error against noise, PT4 plant (Murray 2016, figure 10)"
    figure = draw(frame, title, 0.01, 0.011, (1e-4, 0.1))
    return Outcome(frame, figure, key_numbers(frame, (0.01, 0.1, 0.2, 0.34)))


if __name__ == "__main__":
    main(__file__)
