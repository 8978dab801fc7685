"""Vehicle files that describe no vessel are refused, with the file, the key and the limit."""

import pytest
import tomli_w
from refusal import assert_says

from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, read_toml
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import mesh

VEHICLES = config_folder() / "vehicles"
SKEW = [list(row) for row in read_toml(VEHICLES / "otter.toml")["rigid_body"]["M_rb"]]
SKEW[0][4] = 19.75


@pytest.mark.parametrize(
    ("name", "changes", "told"),
    [
        ("barge", {"rigid_body": {"mass": 8201.0}}, ("mass", "8201", "8200", "sinks")),  # 4 x 2 x 1 m of sea water
        ("barge", {"rigid_body": {"cg": [0.65, 0.0, -0.1]}}, ("deck", "0.650")),  # under water
        ("barge", {"rigid_body": {"cg": [0.0, 0.0, -0.9]}}, ("GM", "centre of gravity", "-0.9")),
        # outside the hull: 1.1 of half the beam of 1.08 m
        ("otter", {"thrusters": {"left": [-0.8, -0.7, 0.0]}}, ("thrusters.left", "-0.7", "0.594")),
        ("otter", {"thrusters": {"left": [-0.8, 0.4, 0.0], "right": [-0.8, -0.4, 0.0]}}, ("thrusters.left", "port")),
        ("otter", {"rigid_body": {"gyration": [0.4, 0.5, 0.6]}}, ("rigid_body", "gyration", "M_rb")),  # given twice
        ("otter", {"rigid_body": {"M_rb": None}}, ("rigid_body", "gyration", "M_rb")),  # or never
        ("otter", {"rigid_body": {"M_rb": SKEW}}, ("rigid_body", "M_rb", "symmetric")),
        ("otter", {"dt": 0.5, "hydrodynamics": {"radiation": "constant"}}, ("dt = 0.5", "stable step", "0.0866")),
        ("otter", {"restoring": "linear", "linear": None}, ("restoring", "[linear]")),
        ("otter", {"hydrodynamics": {"liner": [0.0] * 6}}, ("hydrodynamics.liner", "linear")),
        ("otter", {"hull": {"shape": "sphere"}}, ("hull", "twin_pontoons")),
    ],
)
def test_a_file_that_describes_no_vessel_is_refused(tmp_path, name, changes, told):
    """A shipped file with keys of sections changed; None takes one out, and dt is the step that is asked for."""
    data = read_toml(VEHICLES / f"{name}.toml")
    for key in changes.keys() - {"dt"}:
        value = changes[key]
        data[key] = {**data.get(key, {}), **value} if isinstance(value, dict) else value
    data["hydrodynamics"]["database"] = str(VEHICLES / data["hydrodynamics"]["database"])
    for part in (data, *(value for value in data.values() if isinstance(value, dict))):
        for key in [key for key, value in part.items() if value is None]:
            del part[key]
    file = tmp_path / "broken.toml"
    file.write_text(tomli_w.dumps(data))
    with pytest.raises(ConfigError) as caught:
        load_vehicle(file, changes.get("dt", 0.02))
    assert_says(str(caught.value), "broken.toml", *told)


@pytest.mark.parametrize("name", ["otter", "wamv", "barge"])
def test_shipped_vehicles_float_level_at_their_waterline(name):
    """Within 5 mm and a quarter of a degree, the right way up."""
    model = load_vehicle(name)
    body = model.params.rigid_body
    heave, roll, pitch = Hydrostatics(mesh(model.params.hull), body.mass, body.cg).equilibrium
    assert abs(heave) < 5e-3 and abs(roll) < 1e-6 and abs(pitch) < 5e-3
