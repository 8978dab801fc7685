"""Shipped hulls with thrusters of an Otter's thrust, each by its name, that a wrench commands."""

import re
import shutil
from pathlib import Path

from taichi_sim.config.io import config_folder

STERN = "position = [-0.8, {y}, 0.0]\nthrust_max = 119.7\nthrust_min = -66.7\nlag = 0.1\n"
MORE = {  # kind -> more lines of each stern thruster, more thrusters
    "azimuth": ("turn_rate_deg = 60.0\n", ""),
    "fixed": ("", ""),
    "tunnel": ("", "[actuators.bow]\nposition = [0.7, 0.0, 0.1]\ndirection_deg = 90.0\nthrust_max = 40.0\n"
                   "thrust_min = -40.0\nlag = 0.1\n"),
}  # fmt: skip


def write_hull(file: Path, kind: str = "azimuth", like: str = "otter", actions: str = "wrench") -> Path:
    """Write `file`, a hull `like` a shipped one, with two stern thrusters of a `kind`, and its database."""
    text, (of_each, others) = (config_folder() / "vehicles" / f"{like}.toml").read_text(encoding="utf-8"), MORE[kind]
    pair = "".join(f"[actuators.{side}]\n{STERN.format(y=y)}{of_each}" for side, y in (("l", -0.395), ("r", 0.395)))
    text = re.sub(r"\[thrusters\].*?(?=\[windage\])", pair + others + "\n", text, flags=re.DOTALL)
    text = re.sub(r"^actions = .*\n", "", text, flags=re.MULTILINE).replace(
        "\n[rigid_body]", f'actions = "{actions}"\n[rigid_body]', 1
    )
    file.write_text(text, encoding="utf-8")
    shutil.copy(config_folder() / "vehicles" / f"{like}.hydro.json", file.parent)
    return file
