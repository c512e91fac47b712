"""Writes reference outputs of the command `jaxcslc`, and compares two sets of them.

A change that must not change any number is made between two sets: one of the code before it, one of
the code after it. Each reference is a folder with all that some commands write and print: robots
identified from simulated and real recordings, robot files and C code of them, a derivation, a
check, a designed motion. Only the command line is used, so that the same references can be had of
different code.

    python -m scripts.tools.references write build/before
    python -m scripts.tools.references write build/after --code ../changed --inputs build/before
    python -m scripts.tools.references compare build/before build/after

Commands get a recording by the same relative path in every set, and print no time of theirs: two
sets of the same code are equal. Real recordings are read from `../shared/data` beside the
repository; references of those that are missing are left out, and named.

**Numbers.** Coefficients differ in their standard errors (`DIRECT`, or `SEARCHED` where a search
with a tolerance has found them); other numbers by a part of themselves, and in text by one more
unit of the last digit printed. Numbers that are nearly zero beside others of their array or column
are taken as a part of `FLOOR` times the greatest. Everything else must be equal: words, counts,
keys and files. Keys and files that only the new set has are listed and are no difference.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from scripts.tools.references.commands import DIRECT, REFERENCES
from scripts.tools.references.findings import Findings
from scripts.tools.references.writing import DATA, ROOT, write


_SHOWN = 10  # differences of a reference that are listed


def compare(old: Path, new: Path, *, ignored: Sequence[str] = ()) -> int:
    """Compare two sets of references, and print a row for each and what differs.

    - `ignored`: patterns of entries, as `puma_a/identified/index.html*` or `*.json.warnings*`.

    **Returns** 1 if something is over its limits, missing or not equal.
    """
    limits = {reference.name: reference.limits for reference in REFERENCES}
    names = [path.name for path in sorted(old.iterdir()) if path.is_dir()]
    names.sort(key=lambda name: [*limits, name].index(name))
    print(f"{'reference':<18}{'standard errors':>17}{'limit':>8}{'relative':>10}{'limit':>8}")
    failed = not names
    for name in names:
        if not (new / name).is_dir():
            print(f"{name:<18}missing in {new}")
            failed = True
            continue
        of_name = [pattern.removeprefix(f"{name}/") for pattern in ignored]
        findings = Findings(limits.get(name, DIRECT), of_name)
        findings.folders(old / name, new / name)
        errors, relative = findings.limits
        verdict = "differs" if findings.different else "equal"
        print(
            f"{name:<18}{findings.errors:>17.2g}{errors:>8.0e}{findings.relative:>10.2g}"
            f"{relative:>8.0e}  {verdict}"
        )
        for kind, entries in (("", findings.different), ("new: ", findings.new)):
            for entry in entries[:_SHOWN]:
                print(f"    {kind}{entry}")
            if len(entries) > _SHOWN:
                print(f"    {kind}and {len(entries) - _SHOWN} more")
        failed = failed or bool(findings.different)
    for path in sorted(new.iterdir()):
        if path.is_dir() and path.name not in names:
            print(f"{path.name:<18}new")
    return int(failed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes or compares references."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    writer = commands.add_parser("write", help="run every command, and keep what it writes")
    writer.add_argument("folder", type=Path)
    names = [reference.name for reference in REFERENCES]
    writer.add_argument("--only", nargs="+", choices=names, default=(), help="these references")
    writer.add_argument("--code", type=Path, default=ROOT, help="tree whose jaxcslc runs")
    writer.add_argument("--inputs", type=Path, help="set of references whose inputs are used")
    writer.add_argument("--data", type=Path, default=DATA, help="folder of real recordings")
    comparer = commands.add_parser("compare", help="compare two sets")
    comparer.add_argument("old", type=Path)
    comparer.add_argument("new", type=Path)
    comparer.add_argument(
        "--ignore", action="append", default=[], metavar="PATTERN", help="entries not compared"
    )
    options = parser.parse_args(arguments)
    if options.command == "compare":
        for folder in (options.old, options.new):
            if not folder.is_dir():
                parser.error(f"{folder}: no such folder")
        return compare(options.old, options.new, ignored=options.ignore)
    try:
        return write(
            options.folder,
            code=options.code,
            only=options.only,
            inputs=options.inputs,
            data=options.data,
        )
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    raise SystemExit(main())
