"""Manoeuvring trials of vessels, by the definitions of IMO MSC.137(76) and MSC/Circ.1053.

Positions are those of the vessel's origin (midships) over ground, from where the order was given. Advance is along the
approach's course; transfer is perpendicular to it, positive to the side of the turn. Headings are relative to that of
the approach.

A vessel without rudders is steered by its own means: full helm is its largest yaw command and stands for 35 degrees of
rudder, full helm of a ship, so 10 degrees of helm are 10/35 of it.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.trials.basin import SHIP_HELM, Array, Basin, Setting, Track, last_speed, vessel_of
from taichi_sim.applications.trials.results import Curve, Outcome, Panel, TrialError, crossing, peaks
from taichi_sim.kernels.conventions import GRAVITY, QUATERNION, SURGE
from taichi_sim.kernels.rotation import torch_quaternion_from_euler

SIDES = (("starboard", 1.0), ("port", -1.0))
TURNS = 3.0  # full circles of a turning circle; its steady figures are means over the last one
REVERSALS = 5  # reversals of the helm in a zigzag
SPIRAL_HELMS = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0, 15.0, 20.0, 25.0])  # deg
APART = 0.02  # difference of r' from which the branches of a spiral count as different
EDGE_HELMS = 8  # helms tried between two of a spiral: they find an edge of the loop to 1/18 of the distance
PULL_OUT_HELM = math.radians(20.0)
SETTLED = 1e-4  # change of the yaw rate per length of travel, over U / L, that counts as zero
STEPS = (1.0, 0.1, 0.02, 0.0)  # of a spiral, on the way from full helm to the one that is wanted; assumed
SHARES = np.arange(1, 11) / 10  # shares of full thrust ahead in speed trials
HEEL = math.radians(10.0)  # initial heel of a roll decay
REST = 60.0  # s, time for a hull to come to rest before a roll decay
DECAY = 60.0  # s, duration of a roll decay
TRACK = Panel("Track", "east m", "north m", equal=True)
SAMPLES = 2000  # largest number of samples of a curve


def _watch(
    basin: Basin, ahead: Array, helm: Array, longest: float, done: Callable[[Track], bool], every: int = 200
) -> Track:
    """Motion under held commands until `done`, which is asked every `every` steps, or for `longest` s."""
    rows, times = [basin.sample(helm)], [0.0]
    while basin.time < longest:
        basin.step(ahead, helm)
        rows.append(basin.sample(helm))
        times.append(basin.time)
        if len(times) % every == 0 and done(_track(times, rows)):
            break
    return _track(times, rows)


def _track(times: list[float], rows: list[tuple[Array, ...]]) -> Track:
    return Track(np.array(times), *(np.array(column) for column in zip(*rows, strict=True)))


def _curve(case: str, track: Track) -> Curve:
    """A track with names and units, thinned for drawing."""
    every = max(1, len(track.t) // SAMPLES)
    names = ("t s", "north m", "east m", "roll rad", "heading rad", "u m/s", "v m/s", "r rad/s", "helm rad")
    return Curve(case, {name: column[::every] for name, column in zip(names, track, strict=True)})


def _along(track: Track) -> tuple[Array, Array]:
    """Distances along the approach's course, and to its starboard side, m."""
    north, east, psi = track.north - track.north[0], track.east - track.east[0], track.heading[0]
    c, s = math.cos(psi), math.sin(psi)
    return c * north + s * east, c * east - s * north


def _at(t: Array, values: Array, when: float) -> float:
    return float("nan") if math.isnan(when) else float(np.interp(when, t, values))


def helm_share(basin: Basin, angle: float) -> float:
    """Share of full helm for an `angle` (rad) of helm."""
    most = basin.model.helm_max or SHIP_HELM
    if angle > most * (1 + 1e-9):
        raise TrialError(
            f"{basin.setting.vehicle}: {math.degrees(angle):g} degrees of helm are more than its {math.degrees(most):g}"
        )
    return angle / most


def turning_circle(setting: Setting) -> Outcome:
    """Full turns to either side under held helm (`setting.helm` is the share of full helm)."""
    out = Outcome("turning", "Turning circle", panels=(TRACK, Panel("Speed", "t s", "speed m/s")))
    basin = Basin(setting, len(SIDES))
    approach = basin.approach()
    sides = np.array([side for _, side in SIDES])
    ahead, helm = np.full(basin.envs, setting.ahead), basin.spread(sides) * setting.helm
    enough = TURNS * 2 * math.pi

    def turned(track: Track) -> bool:
        return bool((np.abs(track.heading[-1] - track.heading[0]) > enough).all())

    whole = _watch(basin, ahead, helm, basin.longest / 2, turned)
    for env in range(basin.envs):
        (case, side), run, track = SIDES[env // setting.runs], env % setting.runs, whole.of(env)
        change, (along, right) = side * (track.heading - track.heading[0]), _along(track)
        if not change.max() > math.pi:
            raise TrialError(f"{setting.vehicle}: with a helm of {setting.helm:g} it does not turn through 180 degrees")
        quarter, half = crossing(track.t, change, math.pi / 2), crossing(track.t, change, math.pi)
        last = change > change[-1] - 2 * math.pi
        rate = float((change[-1] - change[last][0]) / (track.t[-1] - track.t[last][0]))
        speed = float(np.trapezoid(track.speed[last], track.t[last]) / (track.t[-1] - track.t[last][0]))
        drift = float(np.mean(np.arctan2(-side * track.v[last], track.u[last])))
        out.add(case, run, (
            ("approach speed", approach[env], "m/s"),
            ("advance", _at(track.t, along, quarter), "m"),
            ("transfer", side * _at(track.t, right, quarter), "m"),
            ("tactical diameter", side * _at(track.t, right, half), "m"),
            ("time to 90 deg", quarter, "s"),
            ("time to 180 deg", half, "s"),
            ("greatest advance", float(along[change < math.pi].max()), "m"),
            ("steady radius", speed / rate, "m"),
            ("steady speed", speed, "m/s"),
            ("steady yaw rate", rate, "rad/s"),
            ("steady drift angle", drift, "rad"),
            ("advance over length", _at(track.t, along, quarter) / basin.length, ""),
            ("tactical diameter over length", side * _at(track.t, right, half) / basin.length, ""),
        ))  # fmt: skip
        if run == 0:
            curve = _curve(case, track)
            curve.columns["speed m/s"] = np.hypot(curve.columns["u m/s"], curve.columns["v m/s"])
            out.curves.append(curve)
    return out


def zigzag(setting: Setting, helm_deg: float, heading_deg: float) -> Outcome:
    """The zigzag (Kempf) trial, beginning to either side.

    Helm is reversed whenever the heading has changed by `heading_deg` to the side of the helm. Overshoot k is the
    change of heading after reversal k. Track reach and times count from the first order.
    """
    kind = f"{helm_deg:g}/{heading_deg:g}"
    name = f"zigzag{helm_deg:g}_{heading_deg:g}"
    out = Outcome(name, f"Zigzag {kind}", panels=(Panel("Heading and helm", "t s", "heading deg"), TRACK))
    basin = Basin(setting, len(SIDES))
    share, mark = helm_share(basin, math.radians(helm_deg)), math.radians(heading_deg)
    approach = basin.approach()
    begun = basin.headings().copy()
    side = basin.spread([s for _, s in SIDES])
    helm, ahead, reversals = share * side, np.full(basin.envs, setting.ahead), [[] for _ in range(basin.envs)]

    def due(heading: Array):
        return (np.sign(helm) * (heading - begun) >= mark) & np.array([len(r) < REVERSALS for r in reversals])

    def act(which, time: float) -> Array:
        nonlocal helm
        helm = np.where(which, -helm, helm)
        for env in np.flatnonzero(which):
            reversals[env].append(time)
        return helm

    rows, times = [basin.sample(helm)], [0.0]
    while basin.time < basin.longest / 2 and min(map(len, reversals)) < REVERSALS:
        helm = basin.step_to(ahead, helm, due, act)
        rows.append(basin.sample(helm))
        times.append(basin.time)
    if min(map(len, reversals)) < 2:
        raise TrialError(
            f"{setting.vehicle}: a helm of {helm_deg:g} degrees does not change its heading by {heading_deg:g}"
        )
    whole = _track(times, rows)
    for env in range(basin.envs):
        (side_name, sign), run, track = SIDES[env // setting.runs], env % setting.runs, whole.of(env)
        case, at = side_name, reversals[env]
        values = [("approach speed", approach[env], "m/s")]
        reached = _at(track.t, _way(track), at[0])
        values += [("initial turning time", at[0], "s"), ("initial turning distance", reached, "m")]
        values += [("initial turning distance over length", reached / basin.length, "")]
        for k, (start, end) in enumerate(zip(at[:-1], at[1:], strict=True)):
            inside = (track.t >= start - 1e-9) & (track.t <= end)
            swing = sign * (-1) ** k * (track.heading[inside] - track.heading[0])
            _, high = peaks(track.t[inside], swing)
            over = (float(high.max()) if len(high) else float(swing.max())) - mark
            values += [(f"overshoot {k + 1}", over, "rad"), (f"time of reversal {k + 1}", start, "s")]
        if len(at) >= 4:
            values.append(("period", at[3] - at[1], "s"))
        out.add(case, run, values)
        if run == 0:
            curve = _curve(case, track)
            curve.columns["heading deg"] = np.degrees(curve.columns["heading rad"] - track.heading[0])
            out.curves.append(curve)
    return out


def _way(track: Track) -> Array:
    """Length of the track so far, m."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(track.north), np.diff(track.east)))))


def _settle(basin: Basin, ahead: Array, helm: Array) -> tuple[Array, Array]:
    """Yaw rate and speed [env] once the vessel has become steady under held commands."""
    step, last = max(int(basin.slowness / 10 / basin.model.dt), 1), None
    end = basin.time + basin.longest / 6
    rate = speed = np.zeros(basin.envs)
    while basin.time < end:
        rates = []
        for _ in range(step):
            basin.step(ahead, helm)
            rates.append(basin.sample(helm)[6])
        rate, speed = rates[-1], np.maximum(np.abs(last_speed(basin.bench.state)), 1e-6)
        if last is not None:
            travelled = step * basin.model.dt * speed / basin.length
            if (np.abs(rate - last) * basin.length / speed < SETTLED * travelled).all():
                break
        last = rate
    return rate, speed


def _branches(setting: Setting, helms: Array) -> tuple[Array, Array, float]:
    """Steady yaw rates and speeds [2, helm] under `helms` (rad), from hard starboard and from hard port; length, m."""
    basin = Basin(replace(setting, runs=1), 2 * len(helms))
    basin.approach()
    ahead, branch = np.full(basin.envs, setting.ahead), np.repeat([1.0, -1.0], len(helms))
    wanted, rate, speed = np.tile(helms / (basin.model.helm_max or SHIP_HELM), 2), branch, branch
    for share in STEPS:
        rate, speed = _settle(basin, ahead, wanted + share * (branch - wanted))
    return rate.reshape(2, -1), speed.reshape(2, -1), basin.length


def _loop_edges(setting: Setting, helms: Array, differ: NDArray[np.bool_]) -> tuple[float, float]:
    """Least and largest helm (rad) at which the branches differ, found between the helms of a spiral."""
    inside = np.flatnonzero(differ)
    # pairs: a helm at which the branches differ, and the next one, at which they do not
    edges = [(helms[inside[0]], helms[max(inside[0] - 1, 0)])]
    edges.append((helms[inside[-1]], helms[min(inside[-1] + 1, len(helms) - 1)]))
    between = np.array([np.linspace(*edge, EDGE_HELMS + 2) for edge in edges])
    rate, speed, length = _branches(setting, between[:, 1:-1].ravel())
    apart = (np.abs(np.subtract(*(rate * length / speed))) > APART).reshape(2, -1)
    last = [len(row) if row.all() else int(np.argmin(row)) for row in apart]  # the last helms at which they differ
    low, high = (0.5 * (row[k] + row[k + 1]) for row, k in zip(between, last, strict=True))
    return float(low), float(high)


def spiral(setting: Setting) -> Outcome:
    """The direct spiral (Dieudonne): steady yaw rate over helm, approached from hard starboard and from hard port.

    All helms are sailed at once. Each is approached from a steady turn under full helm to that side, by steady turns
    under less and less helm (`STEPS`): a vessel that a hard turn has slowed down would leave its branch before the
    branch ends. The loop is where the branches differ. Its edges are then found between the helms.
    """
    out = Outcome("spiral", "Spiral", panels=(Panel("Steady yaw rate", "helm deg", "r' 1"),))
    full = math.degrees(vessel_of(setting).helm_max or SHIP_HELM)
    degrees = SPIRAL_HELMS[full >= SPIRAL_HELMS - 1e-9]
    degrees = np.unique(np.concatenate((-degrees, degrees)))
    helms = np.radians(degrees)
    rate, speed, length = _branches(setting, helms)
    scaled = rate * length / speed
    for k, (case, _) in enumerate(SIDES):
        out.curves.append(Curve(f"from {case}", {
            "helm deg": degrees, "helm rad": helms, "r rad/s": rate[k], "r' 1": scaled[k], "u m/s": speed[k],
        }))  # fmt: skip
        at_zero = int(np.flatnonzero(degrees == 0.0)[0])
        out.add(f"from {case}", 0, (
            ("yaw rate at zero helm", rate[k][at_zero], "rad/s"),
            ("yaw rate at zero helm over U / L", scaled[k][at_zero], ""),
        ))  # fmt: skip
    differ, width, height = np.abs(scaled[0] - scaled[1]) > APART, 0.0, 0.0
    if differ.any():
        low, high = _loop_edges(setting, helms, differ)
        width, height = high - low, float((rate[0] - rate[1]).max())
    out.add("loop", 0, (("width of the loop", width, "rad"), ("height of the loop", height, "rad/s")))
    return out


def pull_out(setting: Setting) -> Outcome:
    """Helm amidships after a steady turn with 20 degrees of helm to either side.

    A vessel that is stable on its course reaches the same yaw rate from both.
    """
    out = Outcome("pull_out", "Pull-out", panels=(Panel("Yaw rate", "t s", "r rad/s"),))
    basin = Basin(setting, len(SIDES))
    share = helm_share(basin, min(PULL_OUT_HELM, basin.model.helm_max or SHIP_HELM))
    basin.approach()
    ahead, helm = np.full(basin.envs, setting.ahead), share * basin.spread([s for _, s in SIDES])
    began, _ = _settle(basin, ahead, helm)
    basin.begin()

    def steady(track: Track) -> bool:
        recent = track.t > track.t[-1] - 3 * basin.slowness
        rates = track.r[recent] * basin.length / np.maximum(track.speed[recent], 1e-6)
        return bool(track.t[-1] > 10 * basin.slowness and (np.ptp(rates, axis=0) < 1e-4).all())

    whole = _watch(basin, ahead, np.zeros(basin.envs), basin.longest / 4, steady)
    for env in range(basin.envs):
        (case, _), run, track = SIDES[env // setting.runs], env % setting.runs, whole.of(env)
        out.add(case, run, (("turning yaw rate", began[env], "rad/s"), ("residual yaw rate", track.r[-1], "rad/s")))
        if run == 0:
            out.curves.append(_curve(case, track))
    left = [out.mean(case, "residual yaw rate") for case, _ in SIDES]
    out.add("both", 0, (("difference of residual rates", left[0] - left[1], "rad/s"),))
    return out


def crash_stop(setting: Setting) -> Outcome:
    """Full astern from the approach until the vessel is dead in the water."""
    out = Outcome("stop", "Crash stop", panels=(TRACK, Panel("Speed", "t s", "u m/s")))
    basin = Basin(setting, 1)
    if not basin.model.backs:
        raise TrialError(
            f"{setting.vehicle}: it cannot push astern as it is commanded (by {', '.join(basin.model.action_names)})"
        )
    approach = basin.approach()
    astern, amidships = np.full(basin.envs, -1.0), np.zeros(basin.envs)
    V = basin.bench.around.current.double().cpu().numpy()

    def through(track: Track) -> Array:
        """Speed ahead of the water [sample, env]."""
        return np.cos(track.heading) * V[:, 0] + np.sin(track.heading) * V[:, 1]

    def stopped(track: Track) -> bool:
        return bool(((track.u - through(track)).min(axis=0) < 0).all())

    whole = _watch(basin, astern, amidships, basin.longest / 4, stopped, every=20)
    for env in range(basin.envs):
        track = whole.of(env)
        when = crossing(track.t, -(track.u - through(whole)[:, env]), 0.0)
        if math.isnan(when):
            raise TrialError(f"{setting.vehicle}: full astern does not stop it in {whole.t[-1]:.0f} s")
        along, right = _along(track)
        reach = _at(track.t, _way(track), when)
        out.add("astern", env, (
            ("approach speed", approach[env], "m/s"),
            ("time to stop", when, "s"),
            ("track reach", reach, "m"),
            ("head reach", _at(track.t, along, when), "m"),
            ("lateral deviation", _at(track.t, right, when), "m"),
            ("heading change", _at(track.t, track.heading - track.heading[0], when), "rad"),
            ("track reach over length", reach / basin.length, ""),
        ))  # fmt: skip
        if env == 0:
            out.curves.append(_curve("astern", track))
    return out


def speed_run(setting: Setting) -> Outcome:
    """Steady speed of straight runs at shares of full thrust (the model's `Vessel.steer` defines full thrust)."""
    out = Outcome("speed", "Speed", panels=(Panel("Steady speed", "ahead 1", "speed m/s"),))
    basin = Basin(replace(setting, runs=1, speed=None), len(SHARES))
    speed = basin.approach(basin.spread(SHARES))
    columns = {"ahead 1": SHARES, "speed m/s": speed, "Froude number 1": speed / math.sqrt(GRAVITY * basin.length)}
    power = basin.model.power(basin.bench.fleet)
    if power is not None:
        columns["power W"] = power[:, 0].double().cpu().numpy()
    for k, share in enumerate(SHARES):
        rows = [(name.rsplit(" ", 1)[0], column[k], name.rsplit(" ", 1)[1]) for name, column in columns.items()]
        out.add(f"{share:.0%}", 0, [(n, v, "" if unit == "1" else unit) for n, v, unit in rows[1:]])
    out.curves.append(Curve("straight", columns))
    return out


def roll_decay(setting: Setting) -> Outcome:
    """Free roll from rest at a heel of 10 degrees.

    The period is the mean between maxima; the damping ratio is that of their logarithmic decrement.
    """
    out = Outcome("roll", "Roll decay", panels=(Panel("Roll", "t s", "roll deg"),))
    basin = Basin(replace(setting, sea=None, air=None, runs=1), 1)
    heeled = np.array([[0.0, 0.0, 0.0, math.cos(HEEL / 2), math.sin(HEEL / 2), *[0.0] * 8]])
    if abs(basin.model.rhs(heeled, np.zeros(len(basin.model.control_names)))[0, 10]) < 1e-9:
        raise TrialError(f"{setting.vehicle}: it has no roll of its own (it rides on the surface)")
    basin.lie()
    zero = np.zeros(basin.envs)
    for _ in range(int(REST / basin.model.dt)):
        basin.step(zero, zero)
    state = basin.bench.state
    euler = basin.bench.read().euler
    state[:, 0, QUATERNION] = torch_quaternion_from_euler(
        *(state.new_tensor(euler[:, k] + (HEEL if k == 0 else 0.0)) for k in range(3))
    )
    state[..., SURGE:] = 0.0
    rest = float(euler[0, 0])
    basin.begin()
    basin.bench.fleet.update()
    whole = _watch(basin, zero, zero, DECAY, lambda _: False).of(0)
    when, high = peaks(whole.t, whole.roll - rest)
    low_at, low = peaks(whole.t, rest - whole.roll)
    strong = high > 1e-4 * HEEL
    when, high = np.concatenate(([0.0], when[strong])), np.concatenate(([HEEL], high[strong]))
    if len(high) < 2:
        raise TrialError(f"{setting.vehicle}: it does not swing: its roll dies out within a period")
    decrement = float(np.mean(np.log(high[:-1] / high[1:])))
    out.add("decay", 0, (
        ("damped period", float(np.mean(np.diff(when))), "s"),
        ("damping ratio", decrement / math.hypot(decrement, 2 * math.pi), ""),
        ("logarithmic decrement", decrement, ""),
        ("first swing to port", float(low[0]), "rad"),
        ("time of it", float(low_at[0]), "s"),
    ))  # fmt: skip
    curve = _curve("decay", whole)
    curve.columns["roll deg"] = np.degrees(curve.columns["roll rad"])
    out.curves.append(curve)
    return out
