"""tools/firmware_landings.py against a stand-in that speaks as much MAVLink as a landing needs; no firmware."""

import json
import sys
from pathlib import Path

import pytest
from folders import TESTS

from rl.commands.shared import run
from tools import firmware_landings

CALM = (
    "landing.distance=[3,4]", "landing.height=[3,4]", "course.speed=[0,0]", "sea.sea_state=2", "air.speed=0",
    'air.turbulence="none"', "air.std=0", "vary={}", "episode_duration=40",
)  # fmt: skip
SETS = [word for text in CALM for word in ("--set", text)]


def _program(folder: Path, text: str) -> Path:
    file = folder / "program"
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return file


@pytest.mark.slow
def test_stand_ins_take_off_fly_to_their_decks_and_land(tmp_path, capsys):
    """In calm air and hs 0.3 m: the whole way of commands, and the benchmark's judge, of two landings at once."""
    pytest.importorskip("pymavlink")
    file = _program(tmp_path, f'exec "{sys.executable}" "{TESTS / "copter_standin.py"}" "$@"')
    words = ["--autopilot", str(file), "--landings", "2", "--instance", "41", "--json", str(tmp_path / "out.json")]
    assert run(firmware_landings.main, [*words, *SETS]) == 0, capsys.readouterr().err
    figures = json.loads((tmp_path / "out.json").read_text())["figures"]
    assert figures["success_rate"][0] > 0.0 and figures["touch_error_p95_m"][0] < 0.5
    assert figures["success_rate"][0] + figures["hard"][0] == 1.0  # the stand-in is told no speed of touching
    assert 0.2 < figures["touch_speed_m_s"][0] < 1.0


@pytest.mark.slow
def test_a_policy_lands_stand_ins_as_their_companion(tmp_path, capsys):
    pytest.importorskip("pymavlink")
    file = _program(tmp_path, f'exec "{sys.executable}" "{TESTS / "copter_standin.py"}" "$@"')
    words = ["--autopilot", str(file), "--landings", "2", "--instance", "45", "--json", str(tmp_path / "out.json")]
    assert run(firmware_landings.main, [*words, *SETS, "--companion", "landing"]) == 0, capsys.readouterr().err
    figures = json.loads((tmp_path / "out.json").read_text())["figures"]
    assert figures["success_rate"][0] == 1.0 and figures["touch_error_p95_m"][0] < 0.3, figures


@pytest.mark.slow
def test_what_is_no_autopilot_is_refused(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pymavlink")
    monkeypatch.setattr(firmware_landings, "COMES_WITHIN", 1.0)
    for path, told in (
        (tmp_path / "nothing", "no program that could be run"),
        (TESTS / "conftest.py", "no program that could be run"),
        (_program(tmp_path, "echo no sim here; exit 3"), "It has ended with status 3. no sim here"),
    ):
        assert run(firmware_landings.main, ["--autopilot", str(path), "--instance", "43", *SETS]) == 1
        assert told in capsys.readouterr().err


def test_instances_beyond_those_of_ardupilot_are_refused(tmp_path, capsys):
    words = ["--autopilot", str(_program(tmp_path, "true")), "--landings", "9", "--at-once", "8", "--instance", "249"]
    assert run(firmware_landings.main, words) == 1
    assert "--instance 249: 8 landings at once need as many instances, of 0 to 255" in capsys.readouterr().err
