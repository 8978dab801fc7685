"""Policies of anybody: what fits acts as it would elsewhere, and what does not is refused by its name."""

import json

import onnx
import pytest
import torch
from command_line import TINY, onnx_session, sets, tiny_run
from small_missions import make
from torch import nn

from rl.learn.export import export_onnx
from rl.learn.policy import CheckpointError, load_policy
from rl.learn.policy_sources import RowPolicy, policies_from, read_onnx
from rl.missions import load_scenario
from rl.runs.folder import load_config

LAZY = ("rl.commands.evaluate", "--episodes", "2", *sets("track.worlds=4", "sea.realisations=4", "episode_duration=3"))


@pytest.fixture(scope="module")
def boats():
    """A team of two boats in three environments, at the beginning of an episode."""
    return make("sea.hs=0").teams["usv"]


def network(inputs: int, outputs: int) -> nn.Module:
    torch.manual_seed(3)
    return nn.Sequential(nn.Linear(inputs, 16), nn.Tanh(), nn.Linear(16, outputs), nn.Sigmoid())


def test_an_onnx_file_acts_as_its_network_for_each_vehicle_and_for_all_at_once(boats, tmp_path):
    seen = boats.observations()
    each, count, actions = seen.shape[-1], boats.fleet.count, len(boats.action_names)
    for together in (1, count):
        net = network(together * each, together * actions)
        export_onnx(net, together * each, tmp_path / "net.onnx")
        policy = read_onnx(tmp_path / "net.onnx")
        assert not policy.named
        with torch.no_grad():
            wanted = net(seen.reshape(-1, together * each)).reshape(*seen.shape[:2], actions)
        torch.testing.assert_close(policy(boats), wanted, atol=1e-6, rtol=0)


def test_a_shipped_evaluator_agrees_with_onnxruntime(boats, tmp_path):
    file = tiny_run() / "usv" / "policy.onnx"
    rows = torch.randn(64, read_onnx(file)._inputs or 0)
    policy = read_onnx(file)
    session = onnx_session(file)
    wanted = torch.from_numpy(session.run(None, {"obs": rows.numpy()})[0])
    torch.testing.assert_close(torch.from_numpy(policy._rows(rows)), wanted, atol=1e-6, rtol=0)


def test_every_source_gives_the_policy_of_its_team(tmp_path, monkeypatch):
    run = tiny_run()
    config, _ = load_config(run)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("import torch\n\ndef still(rows):\n    return torch.zeros(len(rows), 2)\n")
    found = policies_from([str(run), f"usv={run / 'usv' / 'policy.onnx'}", "uav=mine:still"], config)
    assert [type(found[team]).__name__ for team in ("usv", "uav")] == ["RowPolicy"] * 2
    assert type(policies_from([str(run)], config)["uav"]) is type(load_policy(run, config, "uav"))


def test_another_vehicle_than_that_of_the_lessons_is_told(capsys):
    policies_from([str(tiny_run())], load_config(tiny_run())[0])
    assert "warning" not in capsys.readouterr().err
    policies_from(["pretrained"], load_scenario("landing", ('uav.vehicle="x500"',)))
    told = "pretrained: the policy of uav learned with uav.vehicle = 't650', and now acts for 'x500'"
    assert told in capsys.readouterr().err


def refused(source, match, *more: str, teams=("usv",)):
    with pytest.raises(CheckpointError, match=match):
        policies_from([source, *more], load_scenario("paper", TINY), teams)


def test_what_is_no_source_is_named(tmp_path):
    refused("nothing", "nothing: no such policy: wanted is a run's folder, pretrained, FILE.onnx or module:function")
    refused("gone.onnx", "gone.onnx: not a network in ONNX: FileNotFoundError")
    (tmp_path / "bad.onnx").write_text("no network")
    refused(str(tmp_path / "bad.onnx"), "bad.onnx: not a network in ONNX")
    refused(str(tmp_path), "not a run folder")
    refused("usv=a.onnx", "usv: two policies", "usv=b.onnx")
    refused("tug=x.onnx", "no team 'tug' acts; allowed are usv")
    refused("some.onnx", "one policy, and there are usv and uav: usv=some.onnx", teams=("usv", "uav"))


class Counts:
    """A function whose answer depends on how often it was asked."""

    calls = 0

    def __call__(self, rows):
        self.calls += 1
        return torch.full((len(rows), 2), 0.01 * self.calls)


class Remembers:
    """A function that answers with the change since the last call."""

    last = None

    def __call__(self, rows):
        before, self.last = rows[:, :2] if self.last is None else self.last, rows[:, :2]
        return (rows[:, :2] - before[:1]).clamp(-1, 1)


@pytest.mark.parametrize(
    ("rows", "match"),
    [
        (lambda rows: torch.full((len(rows), 2), float("nan")), "its action 'acceleration' of usv is nan"),
        (lambda rows: torch.full((len(rows), 2), 1.5), "is 1.5: actions are finite and from -1 to 1"),
        (lambda rows: torch.zeros(len(rows), 3), r"gives \[\d+, 3\] .* wanted are \[\d+, 2\]: acceleration"),
        (lambda rows: torch.rand(len(rows), 2), "keeps no state, draws no random numbers"),
        (lambda rows: (rows - rows.mean(0))[:, :2].clamp(-1, 1), "decides for each row alone"),
        (Counts(), "keeps no state"),
        (Remembers(), "keeps no state"),
        (lambda rows: rows @ torch.zeros(3, 2), "mine: RuntimeError"),
    ],
)
def test_a_policy_that_is_none_is_refused_by_what_it_does(rows, match, boats):
    with pytest.raises(CheckpointError, match=match):
        RowPolicy(rows, "mine")(boats)


def test_other_names_widths_or_order_are_refused(boats, tmp_path):
    each, names = boats.observations().shape[-1], list(boats.observation_names)
    file, actions = tmp_path / "net.onnx", list(boats.action_names)

    def exported(inputs: int, observations: list[str] | None = None) -> RowPolicy:
        signature = None if observations is None else {"observations": observations, "actions": actions}
        export_onnx(network(inputs, 2), inputs, file, signature)
        return read_onnx(file)

    assert exported(each, names)(boats).shape == (*boats.observations().shape[:2], 2)
    with pytest.raises(CheckpointError, match=f"takes {each + 1} observations; a vehicle of usv has {each}"):
        exported(each + 1)(boats)
    with pytest.raises(CheckpointError, match="their order differs"):
        exported(each, names[::-1])(boats)
    with pytest.raises(CheckpointError, match="it was trained on 'sonar', which usv has not"):
        exported(each, ["sonar", *names[1:]])(boats)


@pytest.mark.parametrize(
    ("outputs", "told"),
    [
        ((), "inputs are none: .*; there is no network in this file"),
        (("actions", "value"), "outputs are actions, value: .*; export the actions alone"),
    ],
)
def test_a_network_of_no_or_several_outputs_is_told(outputs, told, tmp_path):
    tensor = {name: onnx.helper.make_tensor_value_info(name, 1, ["row", 3]) for name in ("obs", *outputs)}
    nodes = [onnx.helper.make_node("Identity", ["obs"], [name]) for name in outputs]
    graph = onnx.helper.make_graph(nodes, "g", [tensor["obs"]], [tensor[name] for name in outputs])
    content = onnx.helper.make_model(graph).SerializeToString() if outputs else b""
    (file := tmp_path / "net.onnx").write_bytes(content)
    with pytest.raises(CheckpointError, match=told):
        read_onnx(file)


@pytest.mark.parametrize("memories", [1, 2])
def test_a_network_of_anybody_has_one_memory_of_each_vehicle(memories, boats, tmp_path):
    class Recurrent(nn.Module):
        def forward(self, obs, *kept):
            after = tuple(0.5 * one + obs[:, :3] for one in kept)
            return torch.tanh(after[0][:, :2]), *after

    example = torch.zeros(1, boats.observations().shape[-1]), *[torch.zeros(1, 3)] * memories
    torch.onnx.export(Recurrent(), example, str(tmp_path / "r.onnx"), dynamo=False,
                      input_names=["obs", *"hc"[:memories]])  # fmt: skip
    if memories == 2:
        with pytest.raises(CheckpointError, match="its inputs are obs, h, c: .* a memory is a second input"):
            read_onnx(tmp_path / "r.onnx")
        return
    policy, seen = read_onnx(tmp_path / "r.onnx"), boats.observations()[..., :3]
    first = policy(boats)
    boats.steps.add_(1)
    second = policy(boats)
    boats.steps.zero_()
    torch.testing.assert_close(first, torch.tanh(seen[..., :2]))
    torch.testing.assert_close(second, torch.tanh(1.5 * seen[..., :2]))
    assert policy(boats).equal(first)


def test_evaluate_takes_a_scenario_and_a_file_for_one_team(here, tmp_path):
    boats = f"usv={tiny_run() / 'usv' / 'policy.onnx'}"
    ending = here(*LAZY, "paper", "--set", "evaluation.settle=1", "--policy", boats)
    assert ending.status == 0, ending.err
    assert json.loads(ending.out)["teams"].keys() == {"usv", "uav"}
    told = ("mine: no policies come with the package", "train --config mine", "--policy")
    here(LAZY[0], "paper", "--set", "name='mine'").fails(*told)
    here(*LAZY, "paper", "--policy", "x.onnx", "--controller", "classical").fails("x.onnx", "leave one of them out")
    here(*LAZY, "otters").fails("otters: not a run folder", "nor a scenario", "shipped scenarios: ")


def test_play_of_a_scenario_writes_here(here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    few = sets("track.worlds=4", "sea.realisations=4")
    ending = here("rl.commands.play", "paper", "--policy", str(tiny_run()), "--duration", "0.5", *few)
    assert ending.status == 0, ending.err
    assert [file.name for file in tmp_path.iterdir()] == ["paper-1000.rrd"]
    ghost = ("--policy", str(tiny_run()), "--ghost", "classical", "--duration", "0.5", *few)
    assert here("rl.commands.play", "paper", *ghost, "--out", "ghost.rrd").status == 0
    assert (tmp_path / "ghost.rrd").stat().st_size > (tmp_path / "paper-1000.rrd").stat().st_size
    here("rl.commands.play", "paper", *ghost, "--out", "ghost.mcap").fails("--ghost: needs a recording for rerun")
    here("rl.commands.play", "paper", *ghost[2:], "--controller", "classical").fails("--ghost classical", "already")
    here("rl.commands.play", "paper", "--worst").fails("--worst", "a run's folder alone")
    here("rl.commands.play", "paper", "--controller", "untrained").fails("only a run's folder")
