"""The part of the page that says which differences are real, from the numbers of a summary."""

import numpy as np

from capture_eval.curves.extract import CurveSet
from capture_eval.evaluation.error_table import evaluate_curves
from capture_eval.evaluation.fit_report import fit_report
from capture_eval.evaluation.hinged_jaw import hinged_jaw
from capture_eval.evaluation.summary import summarise
from capture_eval.interpolation.methods import create_methods
from capture_eval.report.explanation_section import explanation_section

T = np.linspace(0, 1, 11)


def test_the_section_tells_verdicts_best_moments_and_fits() -> None:
    """An accelerating jaw: the quadratic PDE is better than linear, and only by timing."""
    whole = hinged_jaw(T**2)
    curves = CurveSet(whole.curves[44:], whole.positions[44:])
    methods = create_methods([(name, {}) for name in ("linear", "pde_linear", "pde_quadratic")])
    found = evaluate_curves(curves, T, methods, 1.0)
    summary = summarise(found, curves, methods, 1.0, np.ones(11, dtype=bool), "all")
    summary["fit"] = fit_report(
        curves, T, 1.0, found.counted, [1, 3, 5, 7, 9], per_curve=True, orders=(2,), closures=("stiff",)
    )
    section = explanation_section(summary)
    assert section is not None
    assert "no claim about people" in section.text
    pairs, intervals, best, fitted = (table for _, table, _ in section.tables)
    assert [row[0] for row in intervals.rows] == ["geometric linear", "PDE linear (R = 1)", "PDE quadratic (R = 2)"]
    assert intervals.rows[0][5] == intervals.rows[0][7] == best.rows[0][2]  # LAE, where its interval ends, LAE again
    assert "comes from one or few poses" in section.text
    assert [row[0] for row in pairs.rows] == ["not resolved", "worse", "worse"]
    assert "they give the same errors" in pairs.rows[0][1]
    assert "is worse than PDE quadratic" in pairs.rows[1][1]
    assert not section.tables[0][2]  # few pairs are not folded away
    nominal, at_best = (float(best.rows[0][column]) for column in (2, 3))
    assert at_best < 0.3 * nominal
    assert at_best < 1.05 * float(best.rows[2][3])
    assert fitted.rows[0][0] == "linear"
    assert fitted.rows[2][1] == "exponent 2"
    assert fitted.rows[4][1] == "own ones for each of 5 curves"
    assert "judged at t = 0.2, 0.4, 0.6, 0.8" in section.tables[3][0]


def test_older_results_have_no_such_section() -> None:
    assert explanation_section({"methods": {}}) is None
