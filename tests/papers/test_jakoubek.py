"""Tables 4 to 8 of Jakoubek's paper: its published cells, and the correct ones."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from experiments.jakoubek import __main__ as program, cells, charts, prechar, ranking, tables_1_3
from experiments.jakoubek.conclusions import claims
from experiments.jakoubek.independent import CORRECT
from experiments.jakoubek.published import METHODS, REPRODUCED, TABLES
from experiments.jakoubek.systems import GAIN, SYSTEMS, chain, record_of
from scipy import special
from scipy.optimize import brentq

import stepax
from stepax.models._deviation import squared_deviation


CELLS = [(name, cell.method) for name, table in TABLES.items() for cell in table]


def row_of(name, method):
    return cells.all_rows()[name, method]


def test_a_record_as_read_crosses_levels_at_grid_times():
    for system in SYSTEMS.values():
        record = system.record()
        t, y = np.asarray(record.t), np.asarray(record.y)
        changed = record_of(system, t, prechar.as_read(t, y, GAIN))
        found = stepax.crossing_times(changed, np.array(prechar.LEVELS))
        expected = [prechar.reading_time(t, y, GAIN * level) for level in prechar.LEVELS]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * t[-1])
        assert np.sum(changed.y != record.y) <= len(prechar.LEVELS)


def test_twenty_published_cells_are_reproduced_within_rounding():
    reproduced = [key for key in CELLS if row_of(*key).cell.verdict == REPRODUCED]
    assert len(CELLS) == 35
    assert len(reproduced) == 20
    assert [key for key in reproduced if not row_of(*key).within_rounding] == []


def test_where_the_paper_has_no_model_there_is_none():
    for name in ("S4", "S5"):
        row = row_of(name, "smith")
        assert row.cell.lags == ()
        assert row.correct.model is row.recomputed.model is None
        assert row.correct.details["t20"] / row.correct.details["t60"] > 0.555087


def test_programs_faults_explain_the_published_values_of_strejc():
    assert row_of("S2", "strejc").recomputed.lags == pytest.approx([1.01], abs=5e-3)
    assert row_of("S3", "strejc").recomputed.lags == pytest.approx([1.1], abs=5e-3)
    for name, lag in (("S4", 0.495), ("S5", 0.560)):
        row = row_of(name, "strejc")
        assert row.recomputed.lags == pytest.approx([lag] * 4)
        assert row.recomputed.J == pytest.approx(row.J["published"], rel=0.012)


def test_published_errors_belong_to_published_parameters():
    deviations = np.abs(cells.published_errors() - 1)
    assert np.sum(deviations < 0.02) == len(deviations) - 2
    assert np.median(deviations) < 7e-3


@pytest.mark.parametrize("name", SYSTEMS)
def test_correct_cells_agree_with_independent_ones(name):
    for method in METHODS:
        found, expected = row_of(name, method).correct, CORRECT[name][method]
        assert cells.agrees(found, expected), method
        if found.model is None:
            assert math.isnan(expected.J)
        elif expected.J == 0:
            assert cells.is_exact(found.J, name)
        else:
            assert found.J == pytest.approx(expected.J, rel=2e-5), method


def five_lags(t):
    """Response of S5 by partial fractions."""
    lags = np.array(SYSTEMS["S5"].lags)
    weights = [np.prod(x / (x - lags[lags != x])) for x in lags]
    return 1 - weights @ np.exp(-t / lags)


@pytest.mark.parametrize(("height", "lag"), [(0.353, 0.75220), (0.359, 0.75862)])
def test_misprinted_inflection_costs_strejc_its_first_place(height, lag):
    T = brentq(lambda t: five_lags(t) - height, 1, 4) / 3
    assert T == pytest.approx(lag, abs=5e-6)
    J = squared_deviation(chain([T] * 4), SYSTEMS["S5"].plant)
    assert (J < row_of("S5", "latzel").correct.J) == (height == 0.353)
    if height == 0.353:
        assert row_of("S5", "strejc").correct.lags == pytest.approx([T] * 4, rel=1e-7)


RANKINGS = {
    "S1": (
        "V1 SK Strejc Harriott Smith Latzel V2",
        "Smith V1 Harriott SK Strejc Latzel V2",
        "{Harriott Smith Strejc SK V1} Latzel V2",
        0.43,
    ),
    "S2": (
        "Latzel V2 Harriott V1 Smith SK Strejc",
        "Smith Latzel V2 Harriott Strejc V1 SK",
        "{Harriott Latzel Smith Strejc V2} V1 SK",
        0.43,
    ),
    "S3": (
        "Harriott V1 Smith SK Strejc Latzel V2",
        "Smith Strejc Harriott V1 SK Latzel V2",
        "{Harriott Smith Strejc} V1 SK Latzel V2",
        0.52,
    ),
    "S4": (
        "Latzel V2 Harriott V1 SK Strejc",
        "Strejc Latzel V2 Harriott V1 SK",
        "{Latzel Strejc} V2 Harriott V1 SK",
        0.33,
    ),
    "S5": (
        "Latzel V2 Harriott V1 SK Strejc",
        "Strejc Latzel Harriott V2 V1 SK",
        "Strejc Latzel V2 Harriott V1 SK",
        0.20,
    ),
}
"""Published, correct with printed and with exact constants; Kendall's tau of the first two."""


@pytest.mark.parametrize("name", SYSTEMS)
def test_rankings(name):
    published, correct, _, tau = RANKINGS[name]
    assert ranking.as_text(ranking.ranking(name, "published")) == published
    assert ranking.as_text(ranking.ranking(name, "correct")) == correct
    assert ranking.agreement(name) == pytest.approx(tau, abs=0.006)
    assert ranking.agreement(name, methods=ranking.AGREEING) == 1


@pytest.mark.long
@pytest.mark.parametrize("name", SYSTEMS)
def test_rankings_with_exact_constants(name):
    assert ranking.as_text(ranking.ranking(name, "exact")) == RANKINGS[name][2]


@pytest.mark.long
def test_comparison_ranks_like_the_cells():
    system = SYSTEMS["S2"]
    methods = ["viteckova_1", "latzel", "sundaresan_krishnaswamy"]
    compared = stepax.compare(system.record(), methods, plant=system.plant, all_rows=True)
    assert [row.method for row in compared.rows] == ["latzel", "viteckova_1", methods[2]]
    for row in compared.rows:
        assert row.J == pytest.approx(row_of("S2", row.method).correct.J, rel=1e-9)


@pytest.mark.long
def test_conclusions_that_do_not_stand():
    doubtful = {claim.text: claim.verdict for claim in claims() if claim.verdict != "stands"}
    assert doubtful == {
        "S1: the other methods are not recommended": "in part",
        "S3: Strejc gives bad results, is not recommended": "false",
        "S4, S5, high order: Latzel is the best": "in part",
        "S4, S5: Strejc gives bad results": "false",
        "All tables: the order of the methods": "false",
    }


def test_misprints_of_the_tables():
    first, third = tables_1_3.table_1().frame, tables_1_3.table_3().frame
    wrong = first.loc[first.misprinted != "", ["n", "misprinted"]].to_numpy().tolist()
    assert wrong == [[2.5, "alpha10; alpha90"], [14, "mu"], [17, "alpha10"]]
    assert third.loc[third.misprinted != "", ["n", "misprinted"]].to_numpy().tolist() == [
        [3, "y_i"],
        [4, "y_i"],
    ]
    n = first.n.to_numpy()
    np.testing.assert_allclose(first.alpha50_theory, 1 / special.gammaincinv(n, 0.5), rtol=1e-9)


def test_missing_table_of_strejc():
    y = jnp.array([0.15, 0.17, 0.20, 0.25, 0.30])
    ratios = np.asarray(charts.strejc_ratios(y))
    assert ratios[0] == 1
    for ratio, value in zip(ratios[1:], y[1:], strict=True):
        slow, fast = np.exp(-0.3574 * (1 + ratio)), np.exp(-0.3574 * (1 + 1 / ratio))
        response = 1 - (slow - ratio * fast) / (1 - ratio)
        assert response == pytest.approx(float(value), abs=1e-9)


@pytest.mark.parametrize("name", ["table_2", "figure_4", "figure_7", "figure_9"])
def test_parts_write_their_files(name, tmp_path):
    files = program.parts()[name]().write(tmp_path, name)
    assert [path.suffix for path in files] == [".csv", ".png"][: 2 if "figure" in name else 1]
    assert all(path.stat().st_size > 200 for path in files)


def test_every_table_and_figure_has_its_part():
    numbers = [f"table_{n}" for n in range(1, 9)] + [f"figure_{n}" for n in range(1, 14)]
    assert list(program.parts()) == [*numbers, "ranking", "conclusions"]
