"""A run as one self-contained HTML file without scripts.

about.py, failures.py, odds.py and episodes.py make the parts of the page.
"""

from collections.abc import Sequence
from pathlib import Path

from rl.evaluation.store import Run, read_run
from taichi_sim.config.io import replacing

NAME = "report.html"


def write_report(folders: Sequence[Path], out: Path | None = None) -> Path:
    """Write the report of a run, or of two runs side by side; return its file.

    The page names each missing part with the command that makes it.

    Args:
        folders: one or two run folders.
        out: the file; default in the first run's folder.
    """
    # matplotlib takes a second
    from rl.evaluation.report.about import about, configuration, curves, figures, possible, sweeps
    from rl.evaluation.report.episodes import collisions, shown_episodes
    from rl.evaluation.report.failures import failures
    from rl.evaluation.report.odds import odds
    from taichi_sim.visualisation.plotting.page import beside, page, paragraph, photograph, section, style

    runs = [read_run(folder) for folder in folders]
    other = runs[1] if len(runs) > 1 else None
    title = " and ".join(run.name for run in runs)
    with style():
        parts = [
            section("What was trained", beside(*map(about, runs))),
            *(section(_titled("Before and after", run, other), photograph(run.film)) for run in runs if run.film),
            section("Learning", curves(runs)),
            section("Figures", figures(runs[0], other)),
            *(section(_titled("When it fails", run, other), failures(run)) for run in runs),
            *(section(_titled("Odds of failures", run, other), odds(run)) for run in runs),
            *(section(_titled("What is possible", run, other), possible(run)) for run in runs),
            *(section(_titled("Sweeps", run, other), sweeps(run, other if run is runs[0] else None)) for run in runs),
            *(section(_titled("Two episodes", run, other), shown_episodes(run)) for run in runs),
            *(section(_titled("Collisions", run, other), collisions(run)) for run in runs),
            *(section(_titled("Configuration", run, other), configuration(run)) for run in runs),
        ]
    lead = paragraph(f"Scenario {runs[0].config.name}, mission {runs[0].config.mission}.", "faint")
    default = NAME if other is None else f"report-and-{other.name}.html"
    out = folders[0] / default if out is None else out
    with replacing(out) as part:
        part.write_text(page(title, lead, parts), encoding="utf-8")
    return out


def _titled(title: str, run: Run, other: Run | None) -> str:
    return title if other is None else f"{title}: {run.name}"
