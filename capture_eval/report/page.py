"""The report page: one HTML file without any outside resource, escaped throughout."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .verdict import Verdict

DEFINITIONS: tuple[tuple[str, str], ...] = (
    (
        "D",
        "Distance of the two farthest vertices of the neutral model (paper 003, Eq 35). Errors are given in % of D.",
    ),
    (
        "E_A(n, t)",
        "Mean over the points of curve n of the distance between predicted and ground-truth position, over D.",
    ),
    ("E_M(n, t)", "Largest such distance on curve n, over D."),
    ("LAE", "Largest E_A of all curves and in-between poses. LAE(t) is the largest of all curves at one t."),
    ("LME", "Largest E_M of all curves and in-between poses. LME(t) is the largest of all curves at one t."),
    (
        "Per-curve figures",
        "Maximum over t of E_M and mean over t of E_A, the kind of the paper's Figure 8. Its text does not say what it "
        "takes over t, so this is stated here.",
    ),
    ("Ground truth", "The registered meshes of this capture. They carry the errors of reconstruction and tracking."),
    (
        "Noise floor",
        "E_A and E_M, against straight even motion, of curves whose points move less than 0.3 % of D on average: what "
        "reconstruction and tracking add. Never subtracted.",
    ),
    (
        "Timing and path",
        "The error of a point, split along and across the straight line from its first to its last place. Squares add "
        "up. A method that moves points on straight lines can only correct the timing.",
    ),
    (
        "Points that count",
        "Curve points whose tracking confidence is high enough in every pose. Predictions use whole curves.",
    ),
    ("Ratio", "The figure of a method divided by that of geometric linear interpolation; under 1 is better."),
)


@dataclass(frozen=True)
class Picture:
    """One figure of the page."""

    name: str
    title: str
    caption: str
    image: bytes
    kind: str
    width: int
    height: int

    @property
    def data_uri(self) -> str:
        """The picture as text."""
        return f"data:image/{self.kind};base64," + base64.b64encode(self.image).decode("ascii")


@dataclass(frozen=True)
class Table:
    """A table of finished texts; ``marks`` are row classes such as ``failed`` or ``best``."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    marks: Sequence[str] = ()
    text_columns: int = 1
    """How many columns from the left are text; the others are figures, set right."""

    def mark(self, row: int) -> str:
        """Class of a row."""
        return self.marks[row] if row < len(self.marks) else ""


@dataclass(frozen=True)
class Bar:
    """A method's LAE and LME for the bar chart beside the verdict, in per cent of D."""

    label: str
    colour: str
    average: float
    maximum: float


@dataclass(frozen=True)
class Section:
    """Figures and tables under one heading."""

    anchor: str
    title: str
    text: str = ""
    pictures: Sequence[Picture] = ()
    tables: Sequence[tuple[str, Table, bool]] = ()
    """Heading, table, and whether it starts folded."""


@dataclass(frozen=True)
class PageContent:
    """Everything on the page, as texts that are not yet escaped."""

    title: str
    subtitle: str
    verdict: Verdict
    bars: Sequence[Bar]
    scores: Table
    facts: Sequence[tuple[str, str]]
    warnings: Sequence[str]
    sections: Sequence[Section]
    viewer: Mapping[str, Any] | None
    run: Sequence[tuple[str, Table, bool]] = ()
    definitions: Sequence[tuple[str, str]] = field(default=DEFINITIONS)


def render_page(content: PageContent) -> str:
    """Make the HTML of the page.

    Everything a person or a file can put into a name, reason or option is escaped by the template engine; only the
    style sheet, the viewer's script and Plotly itself are inserted as they are.
    """
    import jinja2

    loader = jinja2.PackageLoader("capture_eval.report", "templates")
    environment = jinja2.Environment(
        loader=loader,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["width_of"] = _width
    environment.filters["plain"] = lambda value: f"{value:.3f}" if math.isfinite(value) else "—"
    plotly_script = ""
    if content.viewer is not None:
        from plotly.offline import get_plotlyjs

        plotly_script = get_plotlyjs()
    return environment.get_template("report.html").render(
        page=content,
        style=loader.get_source(environment, "report.css")[0],
        viewer_script=loader.get_source(environment, "viewer.js")[0],
        plotly_script=plotly_script,
        tops={
            "average": max((bar.average for bar in content.bars if math.isfinite(bar.average)), default=1.0),
            "maximum": max((bar.maximum for bar in content.bars if math.isfinite(bar.maximum)), default=1.0),
        },
    )


def _width(value: float, top: float) -> str:
    share = 100.0 * value / top if math.isfinite(value) and top > 0.0 else 0.0
    return f"{share:.2f}"
