"""Which checker looks at which file: a pattern on the file's name, whose named groups become numbers.

To add one: write a function (Case, numbers from the name) -> None that appends checks, and a line here.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from validation import spectra, surface, unity

F64 = ("f64",)
BOTH = ("f64", "f32")


@dataclass(frozen=True)
class Checker:
    """Files whose name matches `pattern` go to `function`, once per precision."""

    pattern: str
    function: Callable[..., None]
    precisions: tuple[str, ...] = F64

    def match(self, path: Path) -> dict[str, float] | None:
        """Numbers in the name of `path`, or None if it is not for this checker. `<x>` stands for a number."""
        pattern = re.sub(r"<(\w+)>", r"(?P<\1>\\d+(?:\\.\\d+)?)", self.pattern)
        found = re.fullmatch(pattern, path.name)
        return {name: float(text) for name, text in found.groupdict().items()} if found else None


CHECKERS = (
    Checker(r"dispersion_g<g>(_.*)?\.csv", spectra.dispersion),
    Checker(r"encounter_frequency_deep.*\.csv", spectra.encounter),
    Checker(r"jonswap_density_samples.*\.csv", spectra.jonswap_density),
    Checker(r"jonswap_moments.*\.json", spectra.jonswap_moments),
    Checker(r"bretschneider_closed_forms.*\.json", spectra.bretschneider),
    Checker(r"pierson_moskowitz_by_wind.*\.json", spectra.pierson_moskowitz_by_wind),
    Checker(r"rayleigh.*\.json", spectra.rayleigh),
    Checker(r"spreading_cos2s.*\.json", spectra.cos2s),
    Checker(r"sum_ka_vs_components.*\.csv", spectra.sum_ka),
    Checker(r"wmo_sea_state_code_3700.*\.csv", spectra.wmo),
    Checker(r"sea(?!_state).*(?<!meta)\.json", surface.sea_components),
    Checker(r"sea.*_gerstner_queries\.csv", surface.gerstner_queries, BOTH),
    Checker(r"sea.*_airy_velocity_pressure\.csv", surface.airy, BOTH),
    Checker(r"gerstner_profile_lambda<wavelength>_t<time>\.csv", surface.profile, BOTH),
    Checker(r"gerstner_single_facts.*\.csv", surface.single_facts, BOTH),
    Checker(r"orbits_deep_lambda<wavelength>_a<amplitude>\.csv", surface.orbits, BOTH),
    Checker(r"boat_m<mass>_L<length>_B<beam>_.*dt<dt>(_.*)?\.csv", unity.boat_sequence),
    Checker(r"aircraft_.*dt<dt>(_.*)?\.csv", unity.aircraft_sequence),
    Checker(r"boat_steady_state_by_mass.*\.csv", unity.boat_steady_state),
)
