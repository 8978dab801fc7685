"""Checks of taichi_sim.surroundings.sea.spectrum and sea_state: dispersion, spectra, moments, spreading (NumPy,
f64)."""

import re
from functools import partial

import numpy as np

from taichi_sim.kernels.conventions import AMPLITUDE, BX
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import (
    Components,
    encounter_frequency,
    group_speed,
    jonswap,
    pierson_moskowitz,
    pierson_moskowitz_hs_tp,
    spectral_moment,
    spreading,
    wavenumber,
)
from taichi_sim.surroundings.sea.wind_sea import sea_state_range
from tests.validation.case import Case
from tests.validation.tables import TableError, number, numbers, read_csv, read_json, records

TWO_PI = 2 * np.pi
WIDE_BAND = (0.1, 1e6)  # times wp: stands for 0 to infinity; the second moment beyond is 1e-12 of the whole
README_BAND = (0.2, 200.0)  # times wp, of the moments, where a file does not say
OPEN_END = 99.0  # Hs_max of the last sea state


def dispersion(case: Case, g: float) -> None:
    """dispersion_g*.csv: k, lengths and speeds at a frequency and depth, coth(k depth) of the sea table."""
    table = read_csv(case.path)
    omega, depth = table["omega"], table["depth_m"]
    ours = {name: np.empty(len(table)) for name in ("k", "group_speed", "coth")}
    for d in np.unique(depth):
        rows, water = depth == d, None if d < 0 else float(d)
        k = wavenumber(omega[rows], water, g)
        ours["k"][rows] = k
        ours["group_speed"][rows] = group_speed(k, water, g)
        one = np.full((k.size, 1), 1e-6)  # m, a wave of any small amplitude
        sea = Sea(Components(one, k[:, None], omega[rows][:, None], 0 * one, 0 * one), water)
        ours["coth"][rows] = (sea.table[:, BX, 0] / sea.table[:, AMPLITUDE, 0]).cpu().numpy()
    case.columns(
        case.elementwise,
        table,
        {
            "k": ours["k"],
            "lambda": TWO_PI / ours["k"],
            "phase_speed": omega / ours["k"],
            "group_speed": ours["group_speed"],
            "horizontal/vertical_orbit_ratio_at_surface_coth_kh": ours["coth"],
        },
    )


def encounter(case: Case) -> None:
    """encounter_frequency_deep*.csv."""
    table = read_csv(case.path)
    ours = encounter_frequency(table["omega"], table["U"], np.deg2rad(table["mu_deg"]))
    case.columns(case.relative, table, {"omega_e_signed": ours, "abs_omega_e": np.abs(ours)})


def jonswap_density(case: Case) -> None:
    """jonswap_density_samples*.csv."""
    table = read_csv(case.path)
    rows = zip(table["omega"], table["Hs"], table["Tp"], table["gamma"], strict=True)
    case.columns(case.elementwise, table, {"S_m2s": np.array([jonswap(*row) for row in rows]).reshape(-1)})


def jonswap_moments(case: Case) -> None:
    """jonswap_moments*.json: quadrature of our density over the band that the file's note names."""
    data = read_json(case.path)
    rows = records(data, "rows")
    found = re.search(r"([\d.]+)\s*wp\s*\.\.\s*([\d.]+)\s*wp", str(data.get("note", "")))
    band = (float(found[1]), float(found[2])) if found else README_BAND
    ours = [_moments(number(r, "Hs"), number(r, "Tp"), number(r, "gamma"), band) for r in rows]
    for key in sorted(set(ours[0]) & set(rows[0])):
        case.elementwise(key, [r[key] for r in ours], numbers(rows, key))


def _moments(hs: float, tp: float, gamma: float, band: tuple[float, float]) -> dict[str, float]:
    wp = TWO_PI / tp
    density = partial(jonswap, hs=hs, tp=tp, gamma_js=gamma)
    m = {n: spectral_moment(density, n, wp, band) for n in (-1, 0, 1, 2)}
    below = {n: spectral_moment(density, n, wp, (band[0], 3.0)) for n in (0, 2)}
    peak = float(density(wp))
    norm = peak / float(jonswap(wp, hs, tp, 1.0)) / gamma
    return {
        "m_1": m[-1],
        "m0": m[0],
        "m1": m[1],
        "m2": m[2],
        "Hm0_approxAg": 4 * np.sqrt(m[0]),
        "ratio_Hm0_over_Hs": 4 * np.sqrt(m[0]) / hs,
        "exact_Ag": norm * hs**2 / 16 / m[0],
        "approx_Ag": norm,
        **_periods(m, tp),
        "m0_fraction_below_3wp": below[0] / m[0],
        "m2_fraction_below_3wp": below[2] / m[2],
        "peak_density": peak,
    }


def _periods(m: dict[int, float], tp: float) -> dict[str, float]:
    return {
        "T01_over_Tp": TWO_PI * m[0] / m[1] / tp,
        "Tz_over_Tp": TWO_PI * np.sqrt(m[0] / m[2]) / tp,
        "Te_over_Tp": TWO_PI * m[-1] / m[0] / tp,
    }


def bretschneider(case: Case) -> None:
    """bretschneider_closed_forms*.json: mean periods of gamma = 1 over the whole frequency axis."""
    data = read_json(case.path)
    density = partial(jonswap, hs=1.0, tp=TWO_PI, gamma_js=1.0)  # ratios do not depend on hs and tp
    m = {n: spectral_moment(density, n, 1.0, WIDE_BAND) for n in (-1, 0, 1, 2)}
    for key, value in _periods(m, TWO_PI).items():
        case.elementwise(key, value, number(data, key))


def pierson_moskowitz_by_wind(case: Case) -> None:
    """pierson_moskowitz_by_wind*.json: heights and peaks, and the height of the density's own quadrature."""
    rows = records(read_json(case.path), "rows")
    wind = numbers(rows, "U19_5")
    hs, tp = np.array([pierson_moskowitz_hs_tp(u) for u in wind]).T
    m0 = [
        spectral_moment(partial(pierson_moskowitz, wind_speed_19_5=u), 0, TWO_PI / t, WIDE_BAND)
        for u, t in zip(wind, tp, strict=True)
    ]
    case.elementwise("Hs", hs, numbers(rows, "Hs"))
    case.elementwise("Hs by quadrature", 4 * np.sqrt(m0), numbers(rows, "Hs"))
    case.elementwise("wp", TWO_PI / tp, numbers(rows, "wp"))
    case.elementwise("Tp", tp, numbers(rows, "Tp"))


def rayleigh(case: Case) -> None:
    """rayleigh*.json: sampling error of m0 only, sqrt(2 pi int S^2 dw / T) over hs^2 / 16, of our density.

    The other constants belong to the Rayleigh distribution, not to this package.
    """
    data = read_json(case.path)
    keys = [k for k in data if k.startswith("relative_std_of_m0_estimate_gamma")]
    if not keys:
        raise TableError("no key 'relative_std_of_m0_estimate_gamma*'")
    for key in keys:
        gamma, rows = float(key.rpartition("gamma")[2]), records(data, key)
        ours = [_m0_error(number(r, "Hs"), number(r, "Tp"), gamma, number(r, "record_s")) for r in rows]
        case.elementwise(key, ours, numbers(rows, "rel_std_of_m0"))


def _m0_error(hs: float, tp: float, gamma: float, record: float) -> float:
    density = partial(jonswap, hs=hs, tp=tp, gamma_js=gamma)
    squared = spectral_moment(lambda w: density(w) ** 2, 0, TWO_PI / tp)
    return float(np.sqrt(TWO_PI * squared / record) / (hs**2 / 16))


def cos2s(case: Case) -> None:
    """spreading_cos2s*.json: norm, mean resultant length, circular deviation of our directional density."""
    rows = records(read_json(case.path), "rows")
    s = numbers(rows, "s")
    node, weight = np.polynomial.legendre.leggauss(400)
    angle = np.pi * node
    r1 = np.array([np.sum(np.pi * weight * spreading(angle, x) * np.cos(angle)) for x in s])
    ours = {
        "norm_cos2s_half_angle": [spreading(0.0, x) for x in s],
        "mean_resultant_r1": r1,
        "circular_std_deg": np.rad2deg(np.sqrt(2 * (1 - r1))),
    }
    for key, values in ours.items():
        case.elementwise(key, values, numbers(rows, key))


def sum_ka(case: Case) -> None:
    """sum_ka_vs_components*.csv: equal bins over 0.6 to 3 wp, each at its middle, of our density."""
    table = read_csv(case.path)
    ours = {"sum_ka": [], "rms_slope": [], "repeat_period_equal_dw_s": []}
    for hs, tp, n in zip(table["Hs"], table["Tp"], table["N"], strict=True):
        edges = TWO_PI / tp * np.linspace(0.6, 3.0, round(n) + 1)
        omega, dw = (edges[:-1] + edges[1:]) / 2, edges[1] - edges[0]
        amplitude = np.sqrt(2 * jonswap(omega, hs, tp) * dw)[None]
        sea = Components(amplitude, wavenumber(omega)[None], omega[None], 0 * amplitude, 0 * amplitude)
        for name, value in zip(ours, (sea.sum_ka[0], sea.rms_slope[0], TWO_PI / dw), strict=True):
            ours[name].append(value)
    case.columns(case.elementwise, table, {name: np.array(values) for name, values in ours.items()})


def wmo(case: Case) -> None:
    """wmo_sea_state_code_3700*.csv."""
    table = read_csv(case.path)
    ours = np.array([sea_state_range(round(code)) for code in table["code"]])
    ours[np.isinf(ours)] = OPEN_END
    case.columns(case.elementwise, table, {"Hs_min_m": ours[:, 0], "Hs_max_m": ours[:, 1]})
