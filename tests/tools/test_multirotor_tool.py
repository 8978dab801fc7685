"""The command that prints a multirotor's hover, trims, modes and loops; a recording of one; its surface."""

import numpy as np
import pytest
import torch

from taichi_sim.config import WorldConfig
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.visualisation.film import Picture, moment_of
from taichi_sim.visualisation.recording import Recorder
from taichi_sim.visualisation.recording.bodies import KEEL, body_mesh
from taichi_sim.visualisation.recording.episode import Body
from taichi_sim.world import World
from tools import aircraft

pytestmark = pytest.mark.usefixtures("f64")
GREY = (128, 128, 128)


def test_it_prints_hover_trims_modes_and_loops_and_draws(capsys, tmp_path):
    picture = tmp_path / "power.png"
    assert aircraft.main(["x500", "--airspeed", "5", "--climb", "10", "--out", str(picture)]) == 0
    text = capsys.readouterr().out
    for part in ("thrust to weight 1.689", "figure of merit", "climb 10 deg", "modes at 5 m/s", "largest stable step",
                 "roll, pitch rate", "bandwidth rad/s"):  # fmt: skip
        assert part in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_overrides_reach_the_model(capsys):
    """Without drag and inflow of the rotors hover is four integrators: nothing but the fuselage is left."""
    overrides = ["rotor.k_d=0", "rotor.k_z=0", "physical.drag=[0, 0, 0]"]
    assert aircraft.main(["x500", *(word for text in overrides for word in ("--set", text))]) == 0
    text = capsys.readouterr().out
    assert "nothing is damped" in text
    rows = [line.split() for line in text.splitlines() if line.startswith(("   0.00", "  16.00"))]
    assert [row[-1] for row in rows] == ["249.3", "249.3"]  # W at 0 and 16 m/s


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["x500", "--radius", "30"], "--radius: a multirotor turns on the spot"),
        (["x500", "--airspeed", "40"], "no steady flight at 40 m/s"),
        (["x500", "--set", "rotor.radius=-1"], "rotor.radius = -1"),
        (["otter"], "not a fixed_wing_6dof or multirotor_6dof; shipped ones are aerosonde, t650, x500, zagi"),
    ],
)
def test_wrong_arguments_are_refused(arguments, told, capsys):
    assert aircraft.main(arguments) == 2
    assert told in capsys.readouterr().err


def test_its_surface_is_closed_and_has_its_size():
    """Each edge is that of two triangles, in opposite directions; volumes are positive: faces look outward."""
    model = load_vehicle("x500")
    vertices, triangles = model.body()
    edges = {(a, b) for t in triangles.tolist() for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0]))}
    assert len(edges) == 3 * len(triangles) and all((b, a) in edges for a, b in edges)
    faces = vertices[triangles]
    assert np.einsum("ij,ij->", faces[:, 0], np.cross(faces[:, 1], faces[:, 2])) / 6 > 0
    length, width, height = np.ptp(vertices, axis=0)
    assert (length, width, height) == pytest.approx(model.size, rel=0.05)
    assert vertices[:, 2].max() == pytest.approx(model.params.body.below)


@pytest.mark.slow
def test_it_is_recorded_filmed_and_dark_from_below():
    """A world with waves and turbulence, two multirotors: a recording has their bodies, air, rotors and loops."""
    sea = {"hs": 0.5, "tp": 4.0, "components": 4, "realisations": 1}
    numbers = {"sea": sea, "air": {"speed": 5.0, "turbulence": "dryden"}, "drones": {"vehicle": "x500", "count": 2}}
    world = World(WorldConfig.model_validate(numbers), 1)
    state = world.teams["drones"].state.clone()
    state[..., 1], state[..., 2] = torch.tensor([0.0, 4.0]), -6.0
    world.place("drones", torch.arange(1), state)
    recorder = Recorder(world)
    for _ in range(10):
        recorder.add(world.step({"drones": torch.full((1, 2, 4), 0.2)}))
    episode = recorder.episode(name="drones")
    track = episode.teams["drones"]
    assert isinstance(track.body, Body) and track.air_n is not None and len(track.air_n) == 10
    assert np.abs(track.air_n[..., 0]).min() > 1.0
    loops = [name for name in track.signals if "loop of" in name]
    assert len(loops) == 6 and track.signals["rotor speeds"].values.shape == (10, 2, 4)
    speeds = track.signals["rotor speeds"].values
    assert (speeds > 500.0).all() and (speeds < 1000.0).all()
    mesh = body_mesh(track, GREY)
    dark = (mesh.colours == KEEL).all(axis=1)
    assert (mesh.normals_b[dark, 2] > 0.5).all() and (
        mesh.normals_b[(mesh.colours == GREY).all(axis=1), 2] < -0.5
    ).all()
    picture = Picture(moment_of(episode, 0.5), (160, 120)).paint(moment_of(episode, 0.5))
    assert picture.shape[:2] == (120, 160)
