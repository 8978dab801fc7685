"""Each number of each shipped vehicle times 1,000, over 1,000 and with the other sign is refused or told, or listed in
docs/extending.md.
"""

import math
import random
import re
import warnings
from fnmatch import fnmatch

import pytest
from folders import ROOT

from taichi_sim.config.plausible import NumberWarning, leaves, scale_of
from taichi_sim.models.catalogue import load_vehicle, shipped_vehicles, step_of
from tests.fuzz.numbers import Slip, change, figures, slips, untold, write

PAGE = ROOT / "docs" / "extending.md"
SHARE = 0.1  # of all numbers and mistakes, by default
HARMLESS = 0.1  # relative change of figures


def listed() -> list[tuple[str, str, str]]:
    """Keys, mistakes and effects on the list of what goes untold."""
    section = PAGE.read_text().partition("## Plausible numbers")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*`) \| ([^|]*) \| ([^|]*) \|", section, re.MULTILINE)
    return [(key, mistakes, effect) for keys, mistakes, effect in rows for key in re.findall("`(.*?)`", keys)]


def on_the_list(slip: Slip) -> str | None:
    """Effect that the page tells; None if it is not there."""
    return next((e for key, wrong, e in listed() if fnmatch(slip.key, key) and slip.mistake in wrong), None)


@pytest.mark.parametrize("file", shipped_vehicles(), ids=lambda file: file.stem)
def test_every_number_has_a_range_that_it_keeps(file):
    with warnings.catch_warnings():
        warnings.simplefilter("error", NumberWarning)
        params = load_vehicle(file, 1e-3).params
    numbers = list(leaves(params))
    assert [leaf.key for leaf in numbers if not leaf.ranges] == []
    low = [leaf.key for leaf in numbers for marker in leaf.ranges if marker.of and not scale_of(leaf, marker.of)]
    assert all(key.startswith(("hydrodynamics.linear", "N_rv", "N_vr")) for key in low), low  # of others that are 0


@pytest.mark.parametrize("file", shipped_vehicles(), ids=lambda file: file.stem)
def test_a_share_of_wrong_numbers_is_told(file):
    given = list(slips(file))
    given = random.Random(file.stem).sample(given, math.ceil(SHARE * len(given)))
    assert [str(slip) for slip in given if untold(slip) and on_the_list(slip) is None] == []


@pytest.mark.slow
def test_all_wrong_numbers_are_told_or_listed():
    given = [slip for file in shipped_vehicles() for slip in slips(file)]
    found = [slip for slip in given if untold(slip)]
    print(*found, sep="\n")
    assert f"({len(given):,} in all), these {len(found)} go untold" in PAGE.read_text()
    assert [str(slip) for slip in found if on_the_list(slip) is None] == []
    for key, mistakes, _ in listed():
        assert any(fnmatch(slip.key, key) and slip.mistake in mistakes for slip in found), f"{key} is told"


@pytest.mark.slow
@pytest.mark.usefixtures("f64")
@pytest.mark.parametrize("file", shipped_vehicles(), ids=lambda file: file.stem)
def test_what_the_page_calls_harmless_is(file, tmp_path):
    """It changes no figure of the trials by more than a tenth; prints the change of each."""
    wrong = [slip for slip in slips(file) if untold(slip) and (on_the_list(slip) or "").startswith("none")]
    if not wrong:
        pytest.skip("nothing goes untold without effect")
    dt, harmful = step_of(file), []
    shipped = figures(file, dt)
    for k, slip in enumerate(wrong):
        (folder := tmp_path / str(k)).mkdir()
        worst, what = change(figures(write(slip, folder), dt), shipped)
        print(f"{worst:8.3f} {slip} ({what})")
        if worst > HARMLESS:
            harmful.append(str(slip))
    assert harmful == []
