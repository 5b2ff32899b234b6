"""Charts: what chance does to them, and what they do to a change."""

import numpy as np

from fiberloom.health.charts import Chart, of_event, of_shift, of_spread


def test_a_ratio_of_likelihoods_has_a_mean_of_one_where_all_is_well():
    rng = np.random.default_rng(0)
    value = rng.standard_normal(400_000)
    for ratio in (of_shift(value, 1.0), of_spread(value**2, 1, 3.0), of_event(value > 1.0, 0.158655, 0.4)):
        # Wald's identity: E exp(log ratio) = 1 under the healthy hypothesis, 400k draws give 0.5 %
        assert abs(np.exp(ratio).mean() - 1.0) < 0.02
        assert ratio.mean() < 0.0


def test_healthy_ones_cross_an_alarm_no_more_often_than_promised():
    rng = np.random.default_rng(1)
    chart, crossed = Chart((2000,), alarm=6.0), 0
    for _ in range(500):
        chart.add(of_shift(rng.standard_normal(2000), 1.0))
        crossed += int((chart.score > chart.alarm).sum())
        chart.forget(np.flatnonzero(chart.score > chart.alarm))
    assert 0 < crossed < 1e6 * np.exp(-6.0)  # e^-h a step is an upper bound (Page, Lorden)


def test_a_change_is_found_after_the_alarm_over_the_mean_ratio():
    rng = np.random.default_rng(2)
    chart, steps = Chart((500,), alarm=20.0), np.zeros(500)
    for k in range(1, 200):
        chart.add(of_shift(rng.standard_normal(500) + 1.0, 1.0))
        steps = np.where((steps == 0) & (chart.score >= 20.0), k, steps)
    assert 35.0 < np.median(steps) < 45.0  # 20 / 0.5


def test_what_is_not_known_changes_nothing():
    chart = Chart((3,), alarm=1.0)
    chart.add(np.array([0.5, np.nan, 0.5]), np.array([True, True, False]))
    np.testing.assert_array_equal(chart.score, [0.5, 0.0, 0.0])
