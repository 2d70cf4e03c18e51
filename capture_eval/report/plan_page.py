"""The plan as one HTML page that opens offline: every expression with its picture, names, weights and proof."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class PageExpression:
    """One expression of the page; ``shapes`` are (name, weight, colour) as finished texts."""

    heading: str
    picture: bytes
    shapes: Sequence[tuple[str, str, str]]
    value: str
    bound: str
    covered: str


@dataclass(frozen=True)
class PlanPage:
    """Everything the page shows, as finished texts; pictures are PNG."""

    title: str
    verdict: str
    facts: Sequence[tuple[str, str]]
    coverage: bytes
    expressions: Sequence[PageExpression]
    uncaptured: Sequence[str]


def render_plan_page(page: PlanPage) -> str:
    """Make the HTML; all texts are escaped by the template engine."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("capture_eval.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = lambda png: "data:image/png;base64," + base64.b64encode(png).decode("ascii")
    return environment.get_template("plan.html").render(page=page)
