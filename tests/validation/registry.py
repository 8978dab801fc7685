"""Which checker looks at which file: a pattern on the file's name, whose named groups become numbers.

To add one: write a function (Case, numbers from the name) -> None that appends checks, and a line here. A function may
decline a table of another form by appending none: several may look at files of one name.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.validation import (
    aerosonde,
    buoys,
    contact,
    cybership2,
    dryden,
    froude_krylov,
    hydrostatics,
    mavsim,
    multirotor,
    otter,
    otter_steady,
    rao,
    ships,
    spectra,
    surface,
    unity,
    wamv,
)

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
    Checker(r"rhs_samples.*\.csv", cybership2.rhs_samples, BOTH),
    Checker(r"(surge_decay|surge_step_tau|turn_tau|sway_yaw_decay).*\.csv", cybership2.trajectory, BOTH),
    Checker(r"summary.*\.json", cybership2.summary, BOTH),
    Checker(r"rhs_samples.*\.csv", otter.rhs_samples, BOTH),
    Checker(r".*_converged\.csv", otter.trajectory, BOTH),
    Checker(r".*_euler_dt<dt>\.csv", otter.coarse_trajectory),
    Checker(r"crossflow_drag_samples.*\.csv", otter.cross_flow, BOTH),
    Checker(r"steady_straight_vs_n.*\.csv", otter_steady.straight),
    Checker(r"summary.*\.json", otter_steady.summary),
    Checker(r".+_rhs_samples_[ABC].*\.csv", multirotor.rhs_samples, BOTH),
    Checker(r".*_[ABC]_converged\.csv", multirotor.series, BOTH),
    Checker(r"trims.*\.json", multirotor.trims),
    Checker(r"closed_forms_.+\.json", multirotor.closed_forms),
    Checker(r"contact_closed_forms.*\.json", contact.closed_forms),
    Checker(r"ground_effect_.+\.csv", multirotor.ground_effect),
    Checker(r"buoyancy_per_point.*\.csv", wamv.buoyancy),
    Checker(r"surge_step_<force>N_m<mass>(_.*)?\.csv", wamv.surge_step, BOTH),
    Checker(r"box_<length>x<beam>x<draft>\.json", hydrostatics.closed_forms),
    Checker(r"gz_wall_sided.*\.csv", hydrostatics.righting_arm),
    Checker(r"gerstner_exact_pressure_lambda<wavelength>_a<amplitude>\.csv", hydrostatics.gerstner_pressure, BOTH),
    Checker(r"froude_krylov_box.*\.csv", froude_krylov.closed_form),
    Checker(r"box_.*_excitation\.csv", froude_krylov.excitation),
    Checker(r"box_.*_rao\.csv", rao.rao, BOTH),
    Checker(r"(?!box_).*_added_mass_damping\.csv", ships.added_mass_damping),
    Checker(r"(?!box_).*_excitation\.csv", ships.excitation),
    Checker(r"(?!box_).*_drift\.csv", ships.drift),
    Checker(r"(?!box_).*_rao\.csv", ships.response),
    Checker(r"rhs_samples_[AB](_.*)?\.csv", aerosonde.rhs_samples, BOTH),
    Checker(r"(?!.*rhs_samples|mavsim_solution_code).*_[AB]\.csv", aerosonde.trajectory, BOTH),
    Checker(r"mavsim_solution_code_.*\.csv", mavsim.solution_code),
    Checker(r"trim_and_modes.*\.json", aerosonde.trim_and_modes),
    Checker(r"published_checks_chap3_chap4.*\.json", aerosonde.published_checks),
    Checker(r"dryden_parameters.*\.json", dryden.parameters, BOTH),
    Checker(r"dryden_autocorrelation.*\.csv", dryden.autocorrelation, BOTH),
    Checker(r"dryden_discrete.*\.csv", dryden.discrete, BOTH),
    Checker(r"dryden_psd_one_sided_rad_s.*\.csv", dryden.spectrum, BOTH),
    Checker(r"mean_wind_profiles.*\.csv", dryden.mean_wind, BOTH),
    Checker(r".*\.spec", buoys.summary),
)
