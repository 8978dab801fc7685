"""Checks of taichi_sim.surroundings.sea.Sea: the Gerstner surface and the linear water under it, in f64 and f32."""

import numpy as np

from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components, wavenumber
from tests.validation.case import TOLERANCE, Case
from tests.validation.tables import Table, TableError, number, numbers, read_csv, read_json, records

TWO_PI = 2 * np.pi
UP = np.array([1.0, 1.0, -1.0])  # the tables' third axis is up, ours is down
PROFILE_POINTS = 8192  # of one wavelength; exact to 1e-9 up to ka = 0.95
DRIFT_POINTS = 64  # instants of a period, and points of a wavelength, in means that are exact for a sine


def _sea_file(case: Case, suffix: str) -> tuple[Sea, dict]:
    """The sea of the JSON beside a table, sea*<suffix>.csv -> sea*.json, and the JSON."""
    path = case.folder.use(case.path.with_name(case.path.name.removesuffix(suffix) + ".json"))
    try:
        data = read_json(path)
        return Sea(_components(data), _depth(data)), data
    except TableError as error:
        raise TableError(f"{path.name}: {error}") from None


def _components(data: dict) -> Components:
    rows = records(data, "components")
    return Components(*(numbers(rows, key)[None] for key in ("a", "k", "omega", "dir_rad", "phase")))


def _depth(data: dict) -> float | None:
    return None if data.get("depth_m") is None else number(data, "depth_m")


def sea_components(case: Case) -> None:
    """sea*.json: dispersion, height and slopes of its components."""
    data = read_json(case.path)
    sea = _components(data)
    case.elementwise("k of omega", wavenumber(sea.omega, _depth(data), number(data, "g")), sea.k)
    for key, ours in (("Hs_of_components", sea.hs), ("sum_ka", sea.sum_ka), ("rms_slope", sea.rms_slope)):
        if key in data:
            case.elementwise(key, ours[0], number(data, key))


def gerstner_queries(case: Case) -> None:
    """sea*_gerstner_queries.csv: inversion, elevation, normal, particle velocity, Jacobian at points."""
    sea, _ = _sea_file(case, "_gerstner_queries.csv")
    table = read_csv(case.path)
    surface = sea.surface(table["x"], table["y"], table["t"])
    label = surface.label.cpu().numpy()
    case.columns(case.length, table, {"eta": surface.elevation.cpu().numpy()})
    case.columns(case.length, table, {"X_label": label[:, 0], "Y_label": label[:, 1]})
    _vector(case, table, "velocity", ("vx", "vy", "vz"), surface.velocity.cpu().numpy() * UP)
    _vector(case, table, "normal", ("nx", "ny", "nz"), surface.normal.cpu().numpy() * UP)
    case.columns(case.relative, table, {"detJ": surface.jacobian.cpu().numpy()})
    if "eta_airy" in table:
        linear = _linear_elevation(sea, table["x"], table["y"], table["t"])
        case.columns(case.length, table, {"eta_airy": linear})


def airy(case: Case) -> None:
    """sea*_airy_velocity_pressure.csv: linear velocity and dynamic pressure under the surface."""
    sea, data = _sea_file(case, "_airy_velocity_pressure.csv")
    table = read_csv(case.path)
    velocity, pressure = sea.airy(table["x"], table["y"], -table["z"], table["t"])
    # Dynamic pressure is proportional to rho g; the case states both.
    scale = number(data, "rho") * number(data, "g") / (RHO_SEA * GRAVITY)
    _vector(case, table, "velocity", ("vx", "vy", "vz"), velocity.cpu().numpy() * UP)
    case.columns(case.relative, table, {"p_dyn_Pa": pressure.cpu().numpy() * scale})


def _vector(case: Case, table: Table, name: str, columns: tuple[str, ...], ours: np.ndarray) -> None:
    """Compare a vector [row, 3] on the scale of its largest component."""
    reference = np.stack([table[c] for c in columns], axis=1)
    case.relative(name, ours, reference, np.stack([table.resolution(c) for c in columns], axis=1))


def _linear_elevation(sea: Sea, x, y, t) -> np.ndarray:
    """Elevation of linear theory: dynamic pressure at z = 0 over rho g."""
    return sea.airy(x, y, 0.0, t)[1].cpu().numpy() / (RHO_SEA * GRAVITY)


def _single_wave(k: float, amplitude: float, depth: float | None = None) -> Sea:
    """One wave with a crest at x = 0 at t = 0, travelling along x."""
    one = np.ones((1, 1))
    omega = np.sqrt(GRAVITY * k)
    return Sea(Components(amplitude * one, k * one, omega * one, 0 * one, 0 * one), depth)


def profile(case: Case, wavelength: float, time: float) -> None:
    """gerstner_profile_lambda*_t*.csv: one deep-water wave of each steepness; skips ka >= 1, too steep."""
    table = read_csv(case.path)
    table = table.where(table["ka"] < 1)
    k, x = TWO_PI / wavelength, table["x"]
    ours = {name: np.empty(len(table)) for name in ("eta_gerstner", "x0_label", "eta_airy", "slope_deta_dx")}
    for ka in np.unique(table["ka"]):
        rows = table["ka"] == ka
        sea = _single_wave(k, ka / k)
        surface = sea.surface(x[rows], 0.0, time)
        ours["eta_gerstner"][rows] = surface.elevation.cpu().numpy()
        ours["x0_label"][rows] = surface.label[:, 0].cpu().numpy()
        ours["eta_airy"][rows] = _linear_elevation(sea, x[rows], 0.0, time)
        ours["slope_deta_dx"][rows] = _slope(surface.normal.cpu().numpy())
    slope = {"slope_deta_dx": ours.pop("slope_deta_dx")}
    case.columns(case.length, table, ours)
    case.columns(case.relative, table, slope)


def _slope(normal: np.ndarray) -> np.ndarray:
    """d zeta / dx of unit normals [..., 3], NED."""
    return normal[..., 0] / normal[..., 2]


def single_facts(case: Case) -> None:
    """gerstner_single_facts*.csv: our surface over one wavelength; skips ka >= 1, too steep."""
    table = read_csv(case.path)
    table = table.where(table["ka"] < 1)
    facts = [_facts(ka) for ka in table["ka"]]
    case.columns(case.relative, table, {name: np.array([f[name] for f in facts]) for name in facts[0]})


def _facts(ka: float) -> dict[str, float]:
    """The wave k = 1, sampled evenly in space; lengths in units of its amplitude."""
    sea = _single_wave(1.0, ka)
    x = np.linspace(-np.pi, np.pi, PROFILE_POINTS, endpoint=False)
    zeta = sea.elevation(x, 0.0).cpu().numpy().astype(np.float64) / ka
    mean = zeta.mean()
    std = zeta.std()
    crossing = x[np.argmax(zeta > mean) - 1] + _interpolate_zero(zeta - mean) * (x[1] - x[0])
    steepest = _steepest(sea, x)
    return {
        "crest/a": zeta.max(),
        "trough/a": zeta.min(),
        "mean_level/a": mean,
        "std/a": std,
        "skewness_over_x": ((zeta - mean) ** 3).mean() / std**3,
        "fraction_of_length_above_mean": -crossing / np.pi,
        "max_slope": steepest,
        "max_slope_angle_deg": np.rad2deg(np.arctan(steepest)),
        "crest_above_mean/a": zeta.max() - mean,
        "trough_below_mean/a": zeta.min() - mean,
    }


def _interpolate_zero(values: np.ndarray) -> float:
    """Fraction of the step in which `values` first rise through zero."""
    i = int(np.argmax(values > 0))
    return float(-values[i - 1] / (values[i] - values[i - 1]))


def _steepest(sea: Sea, x: np.ndarray) -> float:
    """Largest slope, with one closer look around the steepest sample."""
    for _ in range(2):
        slope = np.abs(_slope(sea.surface(x, 0.0, 0.0).normal.cpu().numpy()))
        best, step = x[slope.argmax()], x[1] - x[0]
        x = np.linspace(best - step, best + step, 2001)
    return float(slope.max())


def orbits(case: Case, wavelength: float, amplitude: float) -> None:
    """orbits_deep_lambda*_a*.csv: linear orbits and Stokes drift; Gerstner drift at the surface only."""
    table = read_csv(case.path)
    z0, k = table["z0"], TWO_PI / wavelength
    sea = _single_wave(k, amplitude)
    omega = np.sqrt(GRAVITY * k)
    x = wavelength * np.arange(DRIFT_POINTS) / DRIFT_POINTS
    velocity = sea.airy(x[None, :], 0.0, -z0[:, None], 0.0)[0].cpu().numpy().astype(np.float64) * UP
    speed = np.linalg.norm(velocity, axis=-1).max(axis=1)
    drift = _stokes_drift(velocity[..., 0], velocity[..., 2], k, omega)
    case.columns(case.length, table, {"orbit_radius": speed / omega})
    case.columns(case.relative, table, {"orbital_speed": speed, "airy_stokes_drift": drift})
    top = table.where(z0 == 0)
    if len(top):
        ours = np.full(len(top), _surface_drift(sea, k, omega, amplitude))
        reference = top["gerstner_lagrangian_drift"]
        case.absolute("gerstner_lagrangian_drift at z0 = 0", ours, reference, TOLERANCE[case.precision])


def _stokes_drift(u: np.ndarray, w: np.ndarray, k: float, omega: float) -> np.ndarray:
    """Mean of (displacement . grad) u along x [depth, x], of an irrotational travelling wave.

    x - c t is the only variable: displacement is the primitive of -velocity / c, and d u / dz = d w / dx.
    """
    wave = 1j * k * np.fft.fftfreq(u.shape[1], 1 / u.shape[1])
    celerity = omega / k

    def derivative(f):
        return np.fft.ifft(wave * np.fft.fft(f)).real

    def displacement(f):
        spectrum = np.fft.fft(f)
        primitive = np.divide(spectrum, -celerity * wave, out=np.zeros_like(spectrum), where=wave != 0)
        return np.fft.ifft(primitive).real

    return (displacement(u) * derivative(u) + displacement(w) * derivative(w)).mean(axis=1)


def _surface_drift(sea: Sea, k: float, omega: float, amplitude: float) -> float:
    """Mean velocity over a period of the surface particle with label 0, queried where it then is."""
    t = TWO_PI / omega * np.arange(DRIFT_POINTS) / DRIFT_POINTS
    return float(sea.surface(amplitude * np.sin(omega * t), 0.0, t).velocity[:, 0].double().mean())
