"""Thousands of wrong TOML files: each is refused by its name, or read whole."""

import errno
import os
from pathlib import Path

import pytest

from rl.evaluation.sweeps import load_sweep
from rl.missions import load_scenario
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, load_world, read_toml
from taichi_sim.models.catalogue import load_vehicle
from tests.fuzz.limits import within
from tests.fuzz.mutate import mutations

LIMIT = 20  # s
KINDS = {"": (load_scenario, load_world), "vehicles": (load_vehicle,), "sweeps": (load_sweep,)}  # folder -> readers
COUNT = {"": 140, "vehicles": 80, "sweeps": 130}  # wrong files of each right one
FILES = [(kind, file) for kind in KINDS for file in sorted((config_folder() / kind).glob("*.toml"))]


def refusal(read, file: Path) -> str | None:
    """What is wrong with reading a file; None if it was read, or refused by name."""
    try:
        within(LIMIT, lambda: read(file))
    except ConfigError as error:
        return None if file.name in str(error) else f"does not name the file: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "right"), FILES, ids=[file.stem for _, file in FILES])
def test_a_wrong_file_is_refused_by_name_or_read(kind, right, tmp_path):
    """2,000 in all."""
    wrong = []
    for link in (config_folder() / kind).iterdir():  # what files name lies beside them
        if link.is_file() and link.suffix == ".json":
            (tmp_path / link.name).symlink_to(link)
    (tmp_path / "vehicles").symlink_to(config_folder() / "vehicles")
    for number, (how, content) in enumerate(mutations(right.read_bytes(), COUNT[kind], seed=1, text=True)):
        file = tmp_path / f"wrong_{number}.toml"
        file.write_bytes(content)
        wrong += [f"{number}, {how}: {fault}" for read in KINDS[kind] if (fault := refusal(read, file))]
    assert not wrong, "\n".join(wrong)


def test_what_is_no_text_file_is_refused_by_name(tmp_path):
    """Encodings, folders, loops of links, and numbers that no machine holds."""
    text = (config_folder() / "lanes.toml").read_text(encoding="utf-8")
    made = {
        "utf16.toml": text.encode("utf-16"), "latin1.toml": "# caf\u00e9\n".encode("latin-1"), "empty.toml": b"",
        "nul.toml": b"name = 'a'\0", "huge.toml": b"seed = " + b"9" * 5000, "big.toml": b"seed = 99999999999999999999",
        "deep.toml": b"a = " + b"[" * 100_000, "wide.toml": b"a = " + b"{b = " * 3000 + b"1" + b"}" * 3000,
        "cr.toml": b"seed = 1\rname = 'a'", "date.toml": b"seed = 2020-01-01", "key.toml": b"a." * 2000 + b"b = 1",
    }  # fmt: skip
    for name, content in made.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    os.mkfifo(tmp_path / "pipe.toml")
    for name in (*made, "folder.toml", "loop.toml", "pipe.toml"):
        for read in (load_scenario, load_vehicle, load_sweep):
            with pytest.raises(ConfigError, match=name):
                within(LIMIT, lambda read=read, name=name: read(tmp_path / name))


def test_a_byte_order_mark_is_no_fault(tmp_path):
    """Notepad of Windows writes one."""
    (tmp_path / "marked.toml").write_bytes(b"\xef\xbb\xbf" + (config_folder() / "lanes.toml").read_bytes())
    assert load_scenario(tmp_path / "marked.toml") == load_scenario("lanes")


def test_an_error_of_the_disk_is_named(tmp_path, monkeypatch):
    def fails(*_: object, **__: object) -> str:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Path, "read_text", fails)
    with pytest.raises(ConfigError, match="a.toml: cannot be read: .*Input/output error"):
        read_toml(tmp_path / "a.toml")
