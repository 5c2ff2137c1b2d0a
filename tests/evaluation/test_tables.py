import json
import math

import pytest

from longreach.evaluation.tables import UNKNOWN, label, metric, metric_table


def test_what_is_not_a_number_becomes_none_and_json_takes_it():
    assert [metric(x, "m")["value"] for x in (math.nan, math.inf, 1.5, 3)] == [None, None, 1.5, 3]
    assert json.loads(json.dumps(metric(math.nan, "m"), allow_nan=False)) == {"value": None, "unit": "m"}


def test_every_trajectory_has_a_column_and_every_name_a_row():
    table = metric_table(
        {
            "fused": {"ate_rmse": metric(0.012345, "m"), "nees_mean": metric(2.9, "")},
            "wheels": {"ate_rmse": metric(math.nan, "m"), "pairs": metric(1200, "")},
        }
    )
    assert table.header == ("metric", "unit", "fused", "wheels")
    assert table.rows == (
        ("Position error (ATE) RMSE", "m", "0.01235", UNKNOWN),
        ("NEES mean", "", "2.900", UNKNOWN),
        ("Pairs", "", UNKNOWN, "1200"),
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0.000"), (24.0123, "24.01"), (1234.5678, "1235"), (3.2e-7, "3.20e-07"), (2e6, "2.00e+06")],
)
def test_numbers_keep_about_four_digits(value, text):
    assert metric_table({"fused": {"ate_rmse": metric(value, "m")}}).rows[0][2] == text


def test_lengths_and_spans_are_spelt_out():
    assert label("rpe_0.5s_rotation_rmse") == "Relative error over 0.5 s, rotation RMSE"
    assert label("relations_5s_translation_mean") == "Relations up to 5 s, translation mean"


def test_no_metrics_make_an_empty_table():
    assert metric_table({}).rows == ()


def test_a_word_is_not_said_twice():
    assert label("final_heading_error") == "Final heading error"
    assert label("heading_rms") == "Heading error RMS"
