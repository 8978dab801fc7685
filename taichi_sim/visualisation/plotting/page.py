"""Building blocks of an HTML page. Figures are SVG in the page's own text colour, so that dark pages can show them."""

import base64
import html
import io
import re
from collections.abc import Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taichi_sim.visualisation.plotting import INK, dress, new_figure

COLOURS = {"policy": "#0072B2", "classical": "#D55E00", "other": "#009E73"}
"""Okabe and Ito; "other" is the policy of the run beside."""
FAINT = "#808080"
STYLE = {
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
    **dict.fromkeys(("legend.facecolor", "axes.facecolor", "legend.edgecolor"), "none"),
    "svg.fonttype": "none",  # text stays text: smaller, and in the reader's font
    "svg.hashsalt": "report",  # the same names of clips each time
    "font.size": 9.0,
    "legend.fontsize": 8.0,
}
CSS = """
:root { color-scheme: light dark; --ink: #22313F; --paper: #FFF; --faint: #6B7783; --line: #D5DADF; --card: #F5F7F8 }
@media (prefers-color-scheme: dark) {
  :root { --ink: #DDE3E8; --paper: #14191D; --faint: #96A1AB; --line: #37424B; --card: #1C2329 }
}
body { margin: 0 auto; max-width: 72rem; padding: 1.5rem; color: var(--ink); background: var(--paper);
  font: 15px/1.5 system-ui, sans-serif }
h1 { font-size: 1.6rem; margin: 0 }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid var(--line) }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem } p { margin: .4rem 0 } a { color: inherit }
table { border-collapse: collapse; font-size: .9rem } .wide { overflow-x: auto }
th, td { text-align: left; padding: .2rem .9rem .2rem 0; border-bottom: 1px solid var(--line); vertical-align: top }
.wide td:first-child { white-space: nowrap }
td.n { font-variant-numeric: tabular-nums; white-space: nowrap }
.why { white-space: normal; display: inline-block; max-width: 24rem }
.faint, td i { color: var(--faint); font-style: normal }
.missing { background: var(--card); border-left: 4px solid var(--faint); padding: .5rem .9rem; margin: .6rem 0 }
code, pre { font: .85rem ui-monospace, monospace } pre { overflow-x: auto; background: var(--card); padding: .8rem }
.beside { display: grid; grid-template-columns: repeat(auto-fit, minmax(26rem, 1fr)); gap: 0 1.5rem }
svg, img { max-width: 100%; height: auto; display: block; margin: .4rem 0 }
"""


def text(words: object) -> str:
    """`words`, escaped for HTML."""
    return html.escape(str(words))


def section(title: str, *parts: str) -> str:
    """A part of the page, under a heading."""
    return f"<section><h2>{text(title)}</h2>\n" + "\n".join(part for part in parts if part) + "</section>\n"


def paragraph(words: str, kind: str = "") -> str:
    """A paragraph of the class `kind`; `words` are HTML."""
    return f'<p class="{kind}">{text(words)}</p>' if kind else f"<p>{text(words)}</p>"


def missing(what: str, command: str) -> str:
    """A note that `what` is missing, with the command that makes it."""
    return f'<p class="missing">{text(what)} <code>{text(command)}</code></p>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = True) -> str:
    """A table of HTML cells; all columns but the first have the class `numbers`."""
    kind = ' class="n"' if numbers else ""
    top = "".join(f"<th>{text(name)}</th>" for name in head)
    body = "".join(
        "<tr>" + "".join(f"<td{kind if k else ''}>{cell}</td>" for k, cell in enumerate(row)) + "</tr>\n"
        for row in rows
    )
    return f'<div class="wide"><table><tr>{top}</tr>\n{body}</table></div>'


def folded(title: str, content: str) -> str:
    """Content that opens at a click."""
    return f"<details><summary>{text(title)}</summary>\n{content}</details>"


def beside(*parts: str) -> str:
    """Parts side by side if there is room."""
    return '<div class="beside">' + "".join(f"<div>{part}</div>" for part in parts) + "</div>"


@contextmanager
def style():
    """Draw figures in the style of the page inside this context."""
    with matplotlib.rc_context(STYLE):  # pyright: ignore[reportArgumentType]
        yield


def blank(width: float, height: float) -> Figure:
    """A transparent figure; width and height in inches."""
    figure = new_figure(width, height, "")
    figure.set_facecolor("none")
    return figure


def panel(axes: Axes, title: str, x: str, y: str) -> None:
    """Set title, labels and a grid that is visible on any background."""
    dress(axes, title, x, y)
    axes.title.set_fontsize(9)
    axes.grid(True, color=FAINT, linewidth=0.5, alpha=0.35)


def svg(figure: Figure, name: str) -> str:
    """A figure as an SVG element; screen readers read `name` in its place."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None}, facecolor="none")
    drawn = file.getvalue()
    drawn = re.sub(r"<metadata>.*?</metadata>", "", drawn[drawn.index("<svg") :], flags=re.DOTALL)
    drawn = re.sub(r' xmlns(:\w+)?="[^"]*"', "", drawn)
    # coordinates to a hundredth of a point
    drawn = re.sub(r'(?<= )(d|x|y|transform)="[^"]*"', lambda at: re.sub(r"(\d+\.\d\d)\d+", r"\1", at[0]), drawn)
    drawn = re.sub(f"{INK}|#000000", "currentColor", drawn, flags=re.IGNORECASE)
    return drawn.replace("<svg", f'<svg role="img" aria-label="{text(name)}"', 1)


def photograph(file: Path) -> str:
    """A picture file as an element inside the page."""
    kind = file.suffix.removeprefix(".").lower()
    inside = base64.b64encode(file.read_bytes()).decode("ascii")
    return f'<img alt="film of an episode" src="data:image/{kind};base64,{inside}">'


def page(title: str, lead: str, sections: Iterable[str]) -> str:
    """The whole page as HTML."""
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{text(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{CSS}</style></head>\n<body><h1>{text(title)}</h1>\n{lead}\n{''.join(sections)}</body></html>\n"
    )
