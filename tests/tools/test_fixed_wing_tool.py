"""The command that prints an aircraft's trims, modes and V-n diagram."""

import pytest

from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.uav.fixed_wing.trim import TrimError, trim
from tools import aircraft

pytestmark = pytest.mark.usefixtures("f64")


def test_it_prints_trims_modes_and_envelope_and_draws(capsys, tmp_path):
    picture = tmp_path / "vn.png"
    assert aircraft.main(["zagi", "--climb", "3", "--radius", "80", "--out", str(picture)]) == 0
    text = capsys.readouterr().out
    for part in ("climb 3 deg, radius 80 m", "stall", "throttle at its upper limit", "short_period", "dutch_roll",
                 "largest stable step", "corner"):  # fmt: skip
        assert part in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_it_says_between_which_airspeeds_there_is_steady_flight(capsys):
    assert aircraft.main(["zagi", "--radius", "80"]) == 0
    said = next(row for row in capsys.readouterr().out.splitlines() if row.startswith("steady flight"))
    low, high = float(said.split()[3]), float(said.split()[5])
    p = aircraft.load_aircraft("zagi", [])
    for speed in (low + 0.01, high - 0.01):
        trim(p, speed, turn_radius=80.0)
    for speed in (low - 0.01, high + 0.01):
        with pytest.raises(TrimError):
            trim(p, speed, turn_radius=80.0)


def test_overrides_reach_the_model(capsys):
    assert (
        aircraft.main(["aerosonde", "--set", "longitudinal.C_D_p=0", "--set", "longitudinal.C_D_delta_e=0.0135"]) == 0
    )
    published = next(row for row in capsys.readouterr().out.splitlines() if row.startswith("phugoid"))
    assert published.split()[1:3] == ["0.5004", "0.2097"]  # variant A of the reference


def test_the_envelope_is_that_of_the_lift():
    """n m g = 0.5 rho V^2 S C_L at the stall and at both corners."""
    p = aircraft.load_aircraft("aerosonde", [])
    bounds = aircraft.flight_envelope(p)
    pressure = 0.5 * 1.2682 * 0.55 / (11.0 * GRAVITY)
    assert pressure * bounds.stall**2 * bounds.C_L_max == pytest.approx(1.0)
    assert bounds.largest(bounds.stall) == pytest.approx(1.0)
    assert pressure * bounds.inverted_corner**2 * bounds.C_L_min == pytest.approx(p.envelope.n_min)
    assert (bounds.largest(39.0), bounds.least(39.0)) == (p.envelope.n_max, p.envelope.n_min)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nope"], "no such aircraft; shipped are aerosonde, t650, x500, zagi"),
        (["unity_boat"], "not a fixed_wing_6dof"),
        (["aerosonde", "--set", "foo=1"], "expected SECTION.KEY=VALUE"),
        (["aerosonde", "--set", "lateral.C_n_bta=1"], "did you mean 'C_n_beta'"),
        (["aerosonde", "--airspeed", "50"], "throttle at its upper limit"),
        (["aerosonde", "--airspeed", "0"], "must be positive"),
        (["aerosonde", "--radius", "0"], "must not be zero"),
    ],
)
def test_mistakes_are_told(arguments, told, capsys):
    assert aircraft.main(arguments) == 2
    printed = capsys.readouterr()
    assert told in printed.err and not printed.out
