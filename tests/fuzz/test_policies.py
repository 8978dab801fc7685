"""Thousands of damaged checkpoints: each is refused by its name, or holds the weights that were saved."""

from pathlib import Path

import pytest
import torch

from rl.learn.actor import Actor
from rl.learn.policy import CheckpointError, TrainedPolicy, read_checkpoint, write_checkpoint
from rl.scenario import StageConfig
from tests.fuzz.limits import within
from tests.fuzz.mutate import mutations

LIMIT = 20  # s
STAGE = StageConfig(team="usv", hidden_dims=(4,))


def saved(file: Path) -> Path:
    """A whole checkpoint of five observations and two actions."""
    torch.manual_seed(1)
    actor = Actor(STAGE, 5, 2)
    names = {"observations": list("abcde"), "actions": ["left", "right"]}
    write_checkpoint({"actor_state_dict": actor.state_dict(), "iter": 7, "infos": names}, file)
    return file


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_damaged_checkpoint_is_refused_by_name_or_is_what_was_saved(tmp_path):
    """2,000 of them."""
    right = saved(tmp_path / "model_7.pt")
    seen, wrong = torch.linspace(-1, 1, 15).view(1, 3, 5), []
    wanted = TrainedPolicy.load(right, STAGE).act(seen)
    file = tmp_path / "wrong.pt"
    for number, (how, content) in enumerate(mutations(right.read_bytes(), 2000, seed=1, text=False)):
        file.write_bytes(content)
        try:
            policy = within(LIMIT, lambda: TrainedPolicy.load(file, STAGE))
            if not policy.act(seen).equal(wanted) or policy.signature != TrainedPolicy.load(right, STAGE).signature:
                wrong.append(f"{number}, {how}: read, but it acts otherwise")
        except CheckpointError as error:
            if str(file) not in str(error):
                wrong.append(f"{number}, {how}: does not name the file: {error}")
        except Exception as error:
            wrong.append(f"{number}, {how}: {type(error).__name__}: {error}")
    assert not wrong, f"{len(wrong)} of them\n" + "\n".join(wrong[:50])


def test_what_is_no_checkpoint_is_refused_by_name(tmp_path):
    right = saved(tmp_path / "right.pt")
    (tmp_path / "folder.pt").mkdir()
    (tmp_path / "loop.pt").symlink_to("loop.pt")
    (tmp_path / "empty.pt").write_bytes(b"")
    (tmp_path / "text.pt").write_text("weights")
    torch.jit.save(torch.jit.trace(torch.nn.Linear(5, 2), torch.zeros(1, 5)), str(tmp_path / "policy.pt"))
    for name in ("folder.pt", "loop.pt", "empty.pt", "text.pt", "policy.pt", "gone.pt"):
        with pytest.raises(CheckpointError, match=name):
            TrainedPolicy.load(tmp_path / name, STAGE)
    content = read_checkpoint(right)
    for key, value in (
        ("iter", "7"), ("actor_state_dict", 3), ("actor_state_dict", {}), ("infos", [1]),
        ("actor_state_dict", {"mlp.0.weight": 1, "distribution.std_param": 2}),
        ("actor_state_dict", {name: x.double() * float("nan") for name, x in content["actor_state_dict"].items()}),
    ):  # fmt: skip
        write_checkpoint(content | {key: value}, tmp_path / "odd.pt")
        with pytest.raises(CheckpointError, match="odd.pt"):
            TrainedPolicy.load(tmp_path / "odd.pt", STAGE)
