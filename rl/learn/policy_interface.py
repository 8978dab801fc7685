"""What a policy of a team takes and gives, for people who train one elsewhere (`taichi-sim describe`)."""

from typing import TypedDict

from rl.mission import Mission
from rl.team import Team


class Interface(TypedDict):
    """Inputs and outputs of one team's policy."""

    vehicles: int
    decision_interval_s: float
    episode_s: float
    observations: dict[str, str]  # name, in order -> what it is, with unit and scale
    actions: dict[str, str]
    reward: dict[str, str]  # term -> weight, numbers, what it is; empty: the team's class sums its own


def interface_of(team: Team) -> Interface:
    """The interface of a team's policy."""
    mission: Mission = team.mission
    corrects = team.action_names != team.fleet.model.action_names
    taken = "-1 to 1, others are refused" + "; corrects the classical controller" * corrects
    terms = {name: name.partition(".")[0] for name in team.observation_names}
    return {
        "vehicles": team.fleet.count,
        "decision_interval_s": mission.config.decision_interval,
        "episode_s": mission.config.episode_duration,
        "observations": {name: team.meaning_of(term) for name, term in terms.items()},
        "actions": dict.fromkeys(team.action_names, taken),
        "reward": {name: str(paid) for name, paid in team.paid_by.items()},
    }


def told(name: str, interface: Interface) -> str:
    """An interface as lines to read: numbers of one term share a line."""
    paid = interface["reward"]
    terms: dict[str, list[int]] = {}
    for number, observation in enumerate(interface["observations"]):
        terms.setdefault(observation.partition(".")[0], []).append(number)
    meanings = {observation.partition(".")[0]: text for observation, text in interface["observations"].items()}
    rows = [(_range(numbers), term, meanings[term]) for term, numbers in terms.items()]
    rows += [(str(k), action, text) for k, (action, text) in enumerate(interface["actions"].items())]
    wide = [max(len(row[k]) for row in rows) for k in (0, 1)]
    lines = [f"  {at:>{wide[0]}}  {term:{wide[1]}}  {text}" for at, term, text in rows]
    return "\n".join((
        f"{name}: {interface['vehicles']} vehicles, a decision every {interface['decision_interval_s']:g} s, episodes "
        f"of {interface['episode_s']:g} s",
        f" {len(interface['observations'])} observations of each vehicle, float32, of order one, not clipped; vehicle "
        "0 leads; x squashed by c is x / (|x| + c)",
        *lines[: len(terms)],
        f" {len(interface['actions'])} actions of each vehicle",
        *lines[len(terms) :],
        *([f" {len(paid)} terms of its reward in training"] if paid else ()),
        *(f"  {name:{max(map(len, paid))}}  {text}" for name, text in paid.items()),
    ))  # fmt: skip


def _range(numbers: list[int]) -> str:
    return str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]}-{numbers[-1]}"
