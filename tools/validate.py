"""Check this package against reference tables: published figures and results of independent codes.

    python tools/validate.py --reference DIR [--json FILE] [--report PAGE.md] [--bem FOLDER]
    python tools/validate.py --boats PAGE.md

Tables in DIR and its folders are found by file name and columns. The inputs of a case come from the columns, the name,
and the JSON or TOML file beside it. The tool prints check, largest error, tolerance and result, and the files without a
check. --report also writes a page with pictures, which takes another minute, and keeps its section of boats.

Errors of signed quantities are relative to the table's largest magnitude of that quantity, errors of positive
quantities to each value; errors of lengths are also given in metres (tests/validation/case.py). Tolerances are 1e-6 in
f64, 1e-4 in f32; 1e-4 (m, m/s, rad) for Unity sequences; metres and degrees for trajectories; and those of its checker
where a model has no closed form (tests/validation/*.py). Half a unit of the table's last digit is added. A table whose
inputs are missing or contradict its columns is reported as such.

Exit status: 0 all passed, 1 a check failed or lacks its inputs, 2 nothing to check.
"""

import argparse
import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from taichi_sim.options import output
from tests.validation.boats import write_tables
from tests.validation.document import write
from tests.validation.report import NothingToCheckError, validate


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    parser = argparse.ArgumentParser(description="Check this package against reference tables.")
    parser.add_argument("--reference", type=Path, help="directory of the tables")
    text = "instead: make boats of meshes, sail them beside their truth, write the tables of this page (minutes)"
    parser.add_argument("--boats", type=output, metavar="PAGE.md", help=text)
    parser.add_argument("--json", type=output, help="also write the report here, as JSON")
    parser.add_argument("--report", type=output, help="also write a page (Markdown), with a folder of pictures")
    text = "keep the databases there that are computed for ships without one (minutes each; extra `bem`)"
    parser.add_argument("--bem", type=Path, metavar="FOLDER", help=text)
    arguments = parser.parse_args(argv)
    if arguments.boats:
        write_tables(arguments.boats)
        return 0
    if arguments.reference is None:
        parser.error("--reference DIR, or --boats PAGE.md, is needed")
    try:
        report = validate(arguments.reference, bem=arguments.bem)
    except NothingToCheckError as error:
        print(f"validate: {error}", file=sys.stderr)
        return 2
    print(report.to_text())
    try:
        if arguments.json:
            arguments.json.write_text(report.to_json() + "\n", encoding="utf-8")
        if arguments.report:
            for problem in write(report, arguments.reference, arguments.report):
                print(f"validate: no picture {problem}", file=sys.stderr)
    except OSError as error:
        print(f"validate: {error.filename}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    return 0 if report.passed else 1


if __name__ == "__main__":
    sys.exit(main())
