"""The command `taichi-sim`: everything that the scripts of a checkout do, from any folder, after `pip install`."""

import argparse
import importlib
import runpy
import sys
from collections.abc import Sequence
from pathlib import Path

from rl.commands.shared import run
from rl.commands.tools_folder import bundle

APPLICATIONS = "taichi_sim.applications.commands"
SCRIPTS = {  # name -> module, further arguments, description
    "train": ("rl.train", (), "train the teams of a scenario, evaluate, record, report"),
    "evaluate": ("rl.commands.evaluate", (), "judge a run's policies on unseen episodes"),
    "sweep": ("rl.commands.evaluate", ("--sweep",), "the same under many conditions, beside the classical controller"),
    "odds": ("rl.commands.odds", (), "how likely a rare failure is, with an interval, by splitting"),
    "score": ("rl.commands.score", (), "score a policy in a task of the benchmark: 0 classical, 100 oracle"),
    "describe": ("rl.commands.describe", (), "inputs and outputs of the policies of a task or a scenario"),
    "play": ("rl.commands.play", (), "record, film or watch an episode"),
    "export": ("rl.commands.export", (), "the tables of a recording: vehicles' motion, conditions of its episodes"),
    "pilot": ("rl.commands.pilot", (), "steer real vehicles by a policy, as the MAVLink companion of their autopilots"),
    "report": ("rl.commands.report", (), "write report.html of a run again, or one that compares two runs"),
    "tune": ("rl.commands.tune", (), "search for the numbers of a classical controller"),
    "compare": ("tools.compare", (), "A against B, or each against classical control, with intervals"),
    "benchmark": ("tools.benchmark", (), "measure speed on this machine"),
    "draw-sea": ("tools.draw_sea", (), "a picture of a scenario's sea"),
    "sea-of": ("tools.sea_of", (), "the seas in a file of measured spectra, and which vessels survive them"),
    "aircraft": ("tools.aircraft", (), "trim, modes and V-n diagram, or control loops, of an aircraft"),
    "trials": (f"{APPLICATIONS}.trials", (), "standard trials of a vessel (turning circle, zigzag) or an aircraft"),
    "step": (f"{APPLICATIONS}.step_error", (), "the physics step that a vehicle needs, by the error of its motion"),
    "fit": (f"{APPLICATIONS}.fit", (), "numbers of a vehicle file from logs of a vessel's motion, with intervals"),
    "sitl": ("rl.commands.sitl", (), "be the physics of ArduPilot's SITL (JSON interface) or PX4's (MAVLink)"),
    "hydrodynamics": ("tools.hydrodynamics", (), "a hull's added mass, damping and wave loads from its mesh"),
}
STARTERS = {
    "new-scenario": "write NAME.toml, a scenario to change",
    "new-vehicle": "write NAME.toml and NAME.py, a vehicle of your own",
    "new-mission": "write NAME.toml and NAME.py, a mission of your own",
}


def parser() -> argparse.ArgumentParser:
    """The parser of `taichi-sim`, with a line of help for each command."""
    commands = {name: text for name, (_, _, text) in SCRIPTS.items()} | STARTERS
    wide = max(map(len, commands))
    p = argparse.ArgumentParser(
        prog="taichi-sim",
        description="Simulation and reinforcement learning for teams of vessels on a real sea and aircraft above it.",
        epilog="commands:\n" + "\n".join(f"  {name:{wide}}  {text}" for name, text in commands.items())
        + "\n\ntaichi-sim COMMAND --help explains each; taichi-sim train without arguments does the main job.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    p.add_argument("command", choices=commands, metavar="COMMAND", help="one of the commands below")
    p.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="arguments of the command")
    return p


def starter_parser(name: str) -> argparse.ArgumentParser:
    """The parser of a command that writes starter files."""
    p = argparse.ArgumentParser(prog=f"taichi-sim {name}", description=f"{STARTERS[name]}.".capitalize())
    p.add_argument("name", metavar="NAME")
    if name == "new-scenario":
        p.add_argument("--like", default="paper", metavar="SCENARIO", help="scenario to copy (default: paper)")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit status."""
    given = sys.argv[1:] if argv is None else list(argv)
    if not given:
        parser().print_help()
        return 0
    args = parser().parse_args(given)
    if args.command in STARTERS:
        return _start(args.command, args.arguments)
    module, beside, _ = SCRIPTS[args.command]
    given = list(args.arguments)
    if beside and not set(beside) & set(given) and not {"-h", "--help"} & set(given):
        given += [*beside, "default"]
    sys.argv = [f"taichi-sim {args.command}", *given]
    if module.startswith("rl."):
        return run(importlib.import_module(module).main)
    if module.startswith("tools."):
        sys.path.insert(0, str(bundle()))
    try:
        runpy.run_module(module, run_name="__main__")
    except SystemExit as ended:
        if ended.code is not None and not isinstance(ended.code, int):
            raise
        return ended.code or 0
    return 0


def _start(name: str, arguments: Sequence[str]) -> int:
    """Write starter files and print their names."""
    given = vars(starter_parser(name).parse_args(arguments))

    def write(_: list[str] | None) -> None:
        make = getattr(importlib.import_module("rl.commands.starters"), name.replace("-", "_"))
        for file in make(given.pop("name"), Path(), **given):
            print(file)

    return run(write, [])


if __name__ == "__main__":
    sys.exit(main())
