"""The one look of every figure: sizes, fonts, and one colour and marker per method.

Colours are those of Okabe and Ito (2008), told apart by people with any common colour blindness; every method also
has a marker and a dash of its own, so figures survive a grey printer. Fonts are the ones matplotlib carries, so that
two machines draw the same bytes, and PDF text stays text (Type 42).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

MILLIMETRE = 1.0 / 25.4
SINGLE_COLUMN = 88.0 * MILLIMETRE
DOUBLE_COLUMN = 180.0 * MILLIMETRE

TRUTH_COLOUR = "#000000"
FAILED_COLOUR = "#B2182B"
QUIET_COLOUR = "#6B7280"
BAND_COLOUR = "#F3F4F6"
ERROR_COLOURMAP = "magma_r"

RASTER_DPI = 200


@dataclass(frozen=True)
class MethodStyle:
    """How one method looks in every figure and on the page."""

    label: str
    colour: str
    marker: str
    dash: str | tuple[float, tuple[float, ...]]
    hollow: bool = False


_KNOWN_METHODS: dict[str, MethodStyle] = {
    "linear": MethodStyle("geometric linear", "#CC79A7", "o", "-"),
    "pde_linear": MethodStyle("PDE linear (R = 1)", "#0072B2", "s", (0.0, (4.0, 1.5)), hollow=True),
    "pde_quadratic": MethodStyle("PDE quadratic (R = 2)", "#D55E00", "^", "-"),
    "pde_cubic": MethodStyle("PDE cubic (R = 3)", "#009E73", "D", (0.0, (1.2, 1.2))),
}
_SPARE_STYLES: tuple[tuple[str, str, str | tuple[float, tuple[float, ...]]], ...] = (
    ("#E69F00", "v", (0.0, (6.0, 1.5, 1.2, 1.5))),
    ("#56B4E9", "P", "-"),
    ("#555555", "X", (0.0, (2.5, 1.0))),
    ("#8C6D1F", "<", (0.0, (1.0, 2.0))),
    ("#7B3294", ">", "-"),
    ("#1B7837", "p", (0.0, (5.0, 2.0))),
)


def method_styles(methods: Sequence[str]) -> dict[str, MethodStyle]:
    """Give every method its label, colour, marker and dash.

    The four methods of the paper always look the same; others take the spare styles in the order they are listed,
    and start over, with filled and hollow markers exchanged, when there are more of them than spare styles.

    Parameters
    ----------
    methods
        Method names as they stand in ``errors.csv``.

    Returns
    -------
    dict
        Style by method name, in the given order.
    """
    styles: dict[str, MethodStyle] = {}
    spare = 0
    for method in methods:
        if method in _KNOWN_METHODS:
            styles[method] = _KNOWN_METHODS[method]
            continue
        colour, marker, dash = _SPARE_STYLES[spare % len(_SPARE_STYLES)]
        hollow = (spare // len(_SPARE_STYLES)) % 2 == 1
        styles[method] = MethodStyle(method.replace("_", " "), colour, marker, dash, hollow)
        spare += 1
    return styles


def line_options(style: MethodStyle, marker_size: float = 4.0) -> dict[str, Any]:
    """Return the matplotlib keywords that draw a line with markers in this style."""
    return {
        "color": style.colour,
        "marker": style.marker,
        "linestyle": style.dash,
        "markersize": marker_size + (1.6 if style.hollow else 0.0),
        "markerfacecolor": "none" if style.hollow else style.colour,
        "markeredgecolor": style.colour,
        "markeredgewidth": 0.9 if style.hollow else 0.0,
        "zorder": 4 if style.hollow else 3,
    }


def marker_options(style: MethodStyle, marker_size: float = 4.0) -> dict[str, Any]:
    """Return the matplotlib keywords that draw markers only, without a line, in this style."""
    return {**line_options(style, marker_size), "linestyle": "none"}


@contextmanager
def paper_style() -> Iterator[None]:
    """Draw and save figures under the project's settings; matplotlib's global state is put back on leaving."""
    import matplotlib

    settings: dict[str, Any] = {
        "font.family": "DejaVu Sans",
        "font.size": 7.0,
        "axes.titlesize": 7.5,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelsize": 7.0,
        "xtick.labelsize": 6.5,
        "ytick.labelsize": 6.5,
        "legend.fontsize": 6.5,
        "legend.frameon": False,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.linewidth": 0.6,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "xtick.major.size": 2.5,
        "ytick.major.size": 2.5,
        "axes.grid": True,
        "axes.grid.axis": "y",
        "axes.axisbelow": True,
        "grid.color": "#E1E4E8",
        "grid.linewidth": 0.5,
        "lines.linewidth": 1.1,
        "figure.dpi": 100,
        "savefig.dpi": RASTER_DPI,
        "figure.facecolor": "white",
        "pdf.fonttype": 42,
        "ps.fonttype": 42,
        "svg.fonttype": "none",
        "svg.hashsalt": "capture_eval",
        "image.interpolation": "antialiased",
        "mathtext.fontset": "dejavusans",
    }
    everything: dict[Any, Any] = {**matplotlib.rcParamsDefault, "backend": "agg", **settings}
    with matplotlib.rc_context(everything):
        yield


def new_figure(width: float, height: float, padding: float | None = None) -> Figure:
    """Make a figure of the given size in inches that belongs to no window and no global list.

    ``padding`` in inches sets pictures close together; by default panels keep matplotlib's distance.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    if padding is None:
        layout = ConstrainedLayoutEngine()
    else:
        layout = ConstrainedLayoutEngine(w_pad=padding, h_pad=padding, wspace=0.0, hspace=0.0)
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def error_colourmap() -> Colormap:
    """Return the colour map of errors: pale is small and dark is large, in colour and on a grey printer."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    base = colormaps[ERROR_COLOURMAP]
    return ListedColormap([base(0.06 + 0.86 * step / 255.0) for step in range(256)], name="capture_eval_error")


def mark_failed(axes: Axes, places: Sequence[float], half_width: float, text: str = "failed") -> None:
    """Shade the places on the x axis at which a pose failed, and say so, instead of leaving an unexplained gap."""
    from matplotlib.patheffects import withStroke

    for place in places:
        axes.axvspan(place - half_width, place + half_width, color=FAILED_COLOUR, alpha=0.12, linewidth=0, zorder=0)
        axes.text(
            place,
            0.03,
            text,
            transform=axes.get_xaxis_transform(),
            rotation=90,
            ha="center",
            va="bottom",
            fontsize=5.5,
            color=FAILED_COLOUR,
            path_effects=[withStroke(linewidth=1.5, foreground="white")],
            zorder=6,
        )


def percent_label(symbol: str) -> str:
    """Return an axis label for an error in per cent of D."""
    return f"{symbol}  (% of D)"
