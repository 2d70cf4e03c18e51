"""Tables as text: rounding happens here and nowhere else."""

import numpy as np

from capture_eval.report.tables import Table, errors_csv, per_curve_table, to_csv, to_latex, to_markdown

TABLE = Table("Errors in % of D", ("method", "LME (% D)"), (("pde_linear", 0.12345), ("a|b", None)), digits=2)


def test_csv() -> None:
    assert to_csv(TABLE) == "method,LME (% D)\npde_linear,0.12\na|b,\n"


def test_markdown() -> None:
    assert to_markdown(TABLE).splitlines() == [
        "Errors in % of D",
        "",
        "| method     | LME (% D) |",
        "| ---------- | --------: |",
        "| pde_linear |      0.12 |",
        "| a\\|b       |         – |",
    ]


def test_latex() -> None:
    text = to_latex(TABLE)
    assert r"\caption{Errors in \% of D}" in text
    assert r"pde\_linear & 0.12 \\" in text
    assert r"a|b & -- \\" in text
    assert text.count(r"\begin") == text.count(r"\end") == 2


def test_per_curve_takes_the_maximum_and_the_mean_over_time() -> None:
    average = np.array([[[0.01, 0.03], [np.nan, np.nan]]])
    table = per_curve_table(["lip", "eye"], ["linear"], np.array([[7, 7], [0, 0]]), average, 2 * average)
    assert table.header == ("no.", "curve", "points", "E_M linear", "E_A linear")
    assert table.rows[0] == ("1", "lip", "7", 6.0, 2.0)
    assert table.rows[1] == ("2", "eye", "0", None, None)


def test_errors_keep_every_digit() -> None:
    rows = [("linear", "a, b", 0.1, 3, 1 / 3, 0.1 + 0.2), ("linear", "c", 0.5, 0, float("nan"), float("nan"))]
    assert errors_csv(rows) == (
        "method,curve,t,n_points,E_A,E_M\n"
        'linear,"a, b",0.1,3,0.3333333333333333,0.30000000000000004\n'
        "linear,c,0.5,0,nan,nan\n"
    )
