"""One HTML file that tells a run: self-contained, without scripts, made of what its folder holds.

sources.py reads; about.py, curves.py, sweeps.py and episodes.py each make a part; page.py is how it looks.
"""

from collections.abc import Sequence
from pathlib import Path

NAME = "report.html"


def write_report(folders: Sequence[Path], out: Path | None = None) -> Path:
    """Write the report of a run, or of two side by side, to `out`; default in the first run's folder.

    What is not there yet is named in its place, with the command that makes it.

    Raises:
        RunError: if a folder is not a run.
    """
    from rl.evaluation.report.about import about, figures, possible  # matplotlib takes a second
    from rl.evaluation.report.curves import curves
    from rl.evaluation.report.episodes import collisions, shown_episodes
    from rl.evaluation.report.sources import read_run
    from rl.evaluation.report.sweeps import sweeps
    from taichi_sim.plotting.page import beside, page, paragraph, photograph, section, style

    runs = [read_run(folder) for folder in folders]
    other = runs[1] if len(runs) > 1 else None
    title = " and ".join(run.name for run in runs)
    with style():
        parts = [
            section("What was trained", beside(*map(about, runs))),
            section("Learning", curves(runs)),
            section("Figures", figures(runs[0], other)),
            *(section(_of("What is possible", run, other), possible(run)) for run in runs),
            *(section(_of("Conditions", run, other), sweeps(run, other if run is runs[0] else None)) for run in runs),
            *(section(_of("The recorded episode", run, other), photograph(run.strip)) for run in runs if run.strip),
            *(section(_of("Two episodes", run, other), shown_episodes(run)) for run in runs),
            *(section(_of("Collisions", run, other), collisions(run)) for run in runs),
        ]
    lead = paragraph(f"Scenario {runs[0].config.name}, mission {runs[0].config.mission}.", "faint")
    default = NAME if other is None else f"report-and-{other.name}.html"
    out = folders[0] / default if out is None else out
    part = out.with_name(f"{out.name}.part")
    part.write_text(page(title, lead, parts), encoding="utf-8")
    part.replace(out)
    return out


def _of(title, run, other) -> str:
    return title if other is None else f"{title}: {run.name}"
