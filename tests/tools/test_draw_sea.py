"""tools/draw_sea.py: a picture of any scenario's sea, or a message that says what is wrong."""

import numpy as np
import pytest

from tools import draw_sea

SMALL = ("--set", "sea.realisations=2", "--set", "sea.components=6")
PNG = b"\x89PNG\r\n"


@pytest.mark.slow
def test_a_sea_with_swell_is_drawn(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(draw_sea, "GRID", 24)
    out = tmp_path / "sea.png"
    assert draw_sea.main([*SMALL, "--set", "sea.swell={hs=0.4, tp=9}", "--out", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    assert out.read_bytes().startswith(PNG) and out.stat().st_size > 20_000


def test_welch_finds_the_variance_of_a_wave_at_its_frequency():
    """a^2 / 2 in all, and the peak at omega."""
    a, omega, interval = 0.7, 1.3, 0.1
    time = np.arange(0, 2000, interval)
    w, density = draw_sea.welch(a * np.sin(omega * time + np.array([[0.0], [1.0]])), interval, 1000)
    assert np.trapezoid(density, w) == pytest.approx(a**2 / 2, rel=1e-3)
    assert w[density.argmax()] == pytest.approx(omega, abs=w[1])


def test_heights_are_from_crest_to_trough_of_each_wave():
    phase = np.linspace(0, 8 * np.pi, 8001) - 0.5
    heights = draw_sea.crossing_heights((1 + (phase > 4 * np.pi)) * np.sin(phase))
    assert heights == pytest.approx([2, 2, 4], abs=1e-4)
    assert draw_sea.crossing_heights(np.ones(10)).size == 0


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["atlantis"], ("atlantis", "no such configuration file", "paper")),
        (["--set", "sea.gama_js=2"], ("--set sea.gama_js=2", "unknown key")),
        (["--set", "sea.hs=nan"], ("sea.hs = nan",)),
        (["--set", "sea.hs=3", "--set", "sea.tp=3"], ("too steep", "sum of k a", "sea.hs")),
        (["--set", "sea.hs=0"], ("calm", "hs = 0")),
    ],
)
def test_bad_input_ends_in_a_message_and_status_2(arguments, parts, tmp_path, capsys):
    assert draw_sea.main([*arguments, "--out", str(tmp_path / "sea.png")]) == 2
    message = capsys.readouterr().err
    assert [part for part in parts if part not in message] == []
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("option", "value"), [("--out", "sea.txt"), ("--seed", "-1"), ("--seed", "one")])
def test_a_bad_option_is_named(option, value, capsys):
    with pytest.raises(SystemExit) as caught:
        draw_sea.main([option, value])
    assert caught.value.code == 2
    message = capsys.readouterr().err
    assert option in message and value in message


def test_a_folder_that_is_not_there_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(draw_sea, "GRID", 8)
    out = tmp_path / "nowhere" / "sea.png"
    assert draw_sea.main([*SMALL, "--out", str(out)]) == 0 and out.is_file()
