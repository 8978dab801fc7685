"""Decks and legs that cannot be are refused, with key, value and range."""

import pytest

from taichi_sim.config import ConfigError
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.contact.deck_and_legs import MOST_STEPS


@pytest.mark.parametrize(
    ("vehicle", "changes", "told"),
    [
        ("wamv", {"deck": {"place": [2.0, 0.0]}}, r"deck.place = [2.0, 0.0] is outside the hull: with deck.size = "),
        ("wamv", {"deck": {"place": [2.0, 0.0]}}, r"[1.85, 1.0], |x| must be at most 1.525 m"),
        (
            "wamv",
            {"deck": {"size": [1.0, 3.0]}},
            r"deck.size = [1.0, 3.0] is outside the hull: along y it must be at m",
        ),
        ("wamv", {"deck": {"size": [0.0, 1.0]}}, "deck.size"),
        ("wamv", {"deck": {"height": -0.2}}, "deck.height"),
        ("wamv", {"deck": {"height": -0.2}}, "greater than 0"),
        ("wamv", {"deck": {"friction": -0.2}}, "deck.friction"),
        ("x500", {"legs": {"points": [[0.1, 0.1, -0.2]]}}, "legs.points.0 = [0.1, 0.1, -0.2] is not below the rotors"),
        ("x500", {"legs": {"points": [[0.1, 0.1, -0.2]]}}, "z (down) must be above -0.06 m"),
        ("x500", {"legs": {"points": []}}, "legs.points"),
        ("x500", {"legs": {"stiffness": 9e5}}, "legs.stiffness = 900000: dt = 0.02 s cannot follow it"),
        ("x500", {"legs": {"damping": 2500.0}}, "legs.damping = 2500: dt = 0.02 s cannot follow it"),
        ("x500", {"legs": {"damping": 2500.0}}, "or a damping of at most "),
        ("x500", {"legs": {"stifness": 1.0}}, "legs.stifness"),
    ],
)
def test_a_deck_or_legs_that_cannot_be_are_refused_by_name(vehicle, changes, told):
    with pytest.raises(ConfigError) as error:
        load_vehicle(vehicle, **changes)
    assert f"{vehicle}.toml" in str(error.value) and told in str(error.value)


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_the_step_that_a_refusal_names_is_one_that_it_takes(stiffness):
    """And stiffer legs get more contact steps."""
    soft, legs = load_vehicle("x500").legs, {"stiffness": stiffness}
    assert soft is not None
    body = load_vehicle("x500").params.physical
    stiff = soft.model_copy(update={"stiffness": stiffness})
    frequency, decay = stiff.rates(body.mass, body.cg, body.inertia)
    dt = MOST_STEPS * min(1.25e-3, 0.25 / frequency, 0.5 / decay)
    assert stiff.steps(0.999 * dt, body.mass, body.cg, body.inertia) == MOST_STEPS
    with pytest.raises(ValueError, match=f"legs.stiffness = .*dt of at most {dt:.3g} s"):
        stiff.steps(1.001 * dt, body.mass, body.cg, body.inertia)
    if dt > 0.02:
        assert load_vehicle("x500", legs=legs).contact_steps > load_vehicle("x500").contact_steps  # type: ignore[attr-defined]
