"""Vehicle files that describe no vessel are refused, with the file, the key and the limit."""

import pytest
import tomli_w

from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, read_toml
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import mesh


def refusal(tmp_path, name="otter", dt=0.02, **changes):
    """The message for a shipped vehicle file with sections changed; None removes one."""
    data = read_toml(config_folder() / "vehicles" / f"{name}.toml")
    for key, value in changes.items():
        old = data.pop(key, None)
        if value is not None:
            data[key] = old | value if isinstance(value, dict) and old else value
    if "database" in data.get("hydrodynamics", {}):
        data["hydrodynamics"]["database"] = str(config_folder() / "vehicles" / data["hydrodynamics"]["database"])
    file = tmp_path / "broken.toml"
    file.write_text(tomli_w.dumps(data))
    with pytest.raises(ConfigError) as caught:
        load_vehicle(file, dt)
    return str(caught.value)


def must_name(message, *words):
    for word in words:
        assert word in message, f"{word!r} is not in: {message}"


def test_a_hull_that_sinks(tmp_path):
    message = refusal(tmp_path, "barge", rigid_body={"mass": 8201.0})
    must_name(message, "broken.toml", "mass", "8201", "8200", "sinks")  # 4 x 2 x 1 m of sea water


def test_a_hull_with_its_deck_under_water(tmp_path):
    must_name(refusal(tmp_path, "barge", rigid_body={"cg": [0.65, 0.0, -0.1]}), "broken.toml", "deck", "0.650")


def test_a_hull_that_floats_upside_down(tmp_path):
    message = refusal(tmp_path, "barge", rigid_body={"cg": [0.0, 0.0, -0.9]})
    must_name(message, "broken.toml", "GM", "centre of gravity", "-0.9")


def test_a_thruster_outside_the_hull(tmp_path):
    message = refusal(tmp_path, thrusters={"left": [-0.8, -0.7, 0.0]})
    must_name(message, "broken.toml", "thrusters.left", "-0.7", "0.594")  # 1.1 of half the beam of 1.08 m


def test_thrusters_on_the_wrong_sides(tmp_path):
    swapped = {"left": [-0.8, 0.395, 0.0], "right": [-0.8, -0.395, 0.0]}
    must_name(refusal(tmp_path, thrusters=swapped), "broken.toml", "thrusters.left", "port")


@pytest.mark.parametrize("body", [{"gyration": [0.4, 0.5, 0.6]}, None])
def test_inertia_given_twice_or_never(tmp_path, body):
    body = body or {"M_rb": None}
    data = read_toml(config_folder() / "vehicles" / "otter.toml")["rigid_body"]
    section = {key: value for key, value in (data | body).items() if value is not None}
    file = tmp_path / "broken.toml"
    whole = read_toml(config_folder() / "vehicles" / "otter.toml") | {"rigid_body": section}
    file.write_text(tomli_w.dumps(whole))
    with pytest.raises(ConfigError) as caught:
        load_vehicle(file)
    must_name(str(caught.value), "broken.toml", "rigid_body", "gyration", "M_rb")


def test_an_inertia_that_is_not_symmetric(tmp_path):
    M_rb = [list(row) for row in load_vehicle("otter").params.rigid_body.M_rb]
    M_rb[0][4] = 19.75
    must_name(refusal(tmp_path, rigid_body={"M_rb": M_rb}), "broken.toml", "rigid_body", "M_rb", "symmetric")


def test_a_step_too_long(tmp_path):
    message = refusal(tmp_path, dt=0.5, hydrodynamics={"radiation": "constant"})
    must_name(message, "broken.toml", "dt = 0.5", "largest stable step", "0.0866")


def test_linear_restoring_without_its_numbers(tmp_path):
    must_name(refusal(tmp_path, restoring="linear", linear=None), "broken.toml", "restoring", "[linear]")


def test_a_misspelt_key_and_an_unknown_shape(tmp_path):
    must_name(refusal(tmp_path, hydrodynamics={"liner": [0.0] * 6}), "broken.toml", "hydrodynamics.liner", "linear")
    must_name(refusal(tmp_path, hull={"shape": "sphere"}), "broken.toml", "hull", "twin_pontoons")


@pytest.mark.parametrize("name", ["otter", "wamv", "barge"])
def test_shipped_vehicles_float_level_at_their_waterline(name):
    """Within 5 mm and a quarter of a degree, the right way up."""
    model = load_vehicle(name)
    body = model.params.rigid_body
    heave, roll, pitch = Hydrostatics(mesh(model.params.hull), body.mass, body.cg).equilibrium
    assert abs(heave) < 5e-3 and abs(roll) < 1e-6 and abs(pitch) < 5e-3
