"""Checkpoints that are broken, malicious or of another network: named, never executed, and nothing is lost."""

import json
import os
import pickle
from pathlib import Path

import pytest
import torch
from command_line import content, forget, sets

from rl.learn.policy import checkpoints


class Malice:
    """Pickles to something that makes a file when it is loaded."""

    def __init__(self, marker: Path):
        self.marker = marker

    def __reduce__(self):
        return os.system, (f"touch {self.marker}",)


def put(run: Path, what: str, marker: Path) -> Path:
    """Put a bad checkpoint where the newest one of the USV team would be."""
    good, file = checkpoints(run / "usv")[-1], run / "usv" / "model_99.pt"
    if what == "half":
        file.write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    elif what == "empty":
        file.write_bytes(b"")
    elif what == "malicious":
        torch.save({"actor_state_dict": Malice(marker), "iter": 99}, file)
    elif what == "malicious pickle":
        file.write_bytes(pickle.dumps(Malice(marker), protocol=2))
    elif what == "something else":
        torch.save({"weights": torch.zeros(3)}, file)
    elif what == "a list":
        torch.save([1, 2], file)
    return file


@pytest.mark.parametrize("what", ["half", "empty", "malicious", "malicious pickle", "something else", "a list"])
def test_a_bad_checkpoint_is_named_and_executes_nothing(what, here, run, tmp_path):
    file = put(run, what, tmp_path / "marker")
    before = content(run)
    here("rl.commands.evaluate", run).fails(str(file), "checkpoint")
    here("rl.commands.play", run).fails(str(file), "checkpoint")
    here("rl.train", "--out", run, "--resume").fails(str(file), "checkpoint")
    assert not (tmp_path / "marker").exists()
    assert content(run) == before


def test_a_checkpoint_of_another_network_is_named(here, run):
    config = run / "config.toml"
    config.write_text(config.read_text().replace("64,\n    64,", "32,\n    32,"))
    here("rl.commands.evaluate", run).fails("model_4.pt", "network")


def test_policies_of_other_observations_are_refused(here, run):
    here("rl.commands.evaluate", run, "--set", "sensing.obstacles=5").fails("observations", "trained on")


@pytest.mark.parametrize("count", [*(pytest.param(n, marks=pytest.mark.slow) for n in (1, 8)), 16])
def test_policies_fly_teams_of_another_size_and_shape(here, run, count):
    """Trained with three abreast; 16 wedges are 85 m wide to a side, and bends 100 m."""
    others = (f"usv.count={count}", f"uav.count={count}", "usv.formation=wedge", "uav.formation=wedge")
    ending = here("rl.commands.evaluate", run, *sets(*others, "usv.formation.change_every=1"))
    assert ending.status == 0, ending.err
    assert set(json.loads(ending.out)["teams"]) == {"usv", "uav"}


def spoil(checkpoint: Path) -> None:
    """Make every weight of an actor NaN."""
    saved = torch.load(checkpoint, weights_only=True)
    for tensor in saved["actor_state_dict"].values():
        if tensor.is_floating_point():
            tensor.fill_(float("nan"))
    torch.save(saved, checkpoint)


def test_a_policy_that_acts_nan_is_named(here, run):
    spoil(checkpoints(run / "usv")[-1])
    here("rl.commands.evaluate", run).fails("finite")
    here("rl.commands.play", run).fails("finite")


def test_training_that_has_diverged_is_named_and_nothing_is_lost(here, run):
    forget(run)
    checkpoints(run / "uav")[-1].unlink()
    spoil(checkpoints(run / "uav")[-1])
    before = {file: file.read_bytes() for file in run.rglob("*.pt")}
    here("rl.train", "--out", run, "--resume").fails(str(run / "uav"), "finite")
    assert {file: file.read_bytes() for file in run.rglob("*.pt")} == before
