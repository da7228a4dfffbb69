"""`python -m tiepoint.cluster INPUT... -o OUTPUT`: `reconstruct` as a command."""

import argparse
import contextlib
import inspect
import json
import sys
from typing import Any

import tiepoint

from . import reconstruct
from .driver import NOT_OPTIONS, SHARDS
from .report import text_of
from .tasks import STAGES


def parser_of() -> argparse.ArgumentParser:
    """Its own options, and those of the stages."""
    parser = argparse.ArgumentParser("python -m tiepoint.cluster", description=__doc__)
    add = parser.add_argument
    add("inputs", nargs="+", metavar="INPUT", help="folder of photos, or s3://bucket/photos")
    add("-o", "--output", required=True, help="workspace, or s3://bucket/workspace")
    add("--address", help="of the cluster; by default RAY_ADDRESS, or this machine alone")
    add("--shards", type=int, default=SHARDS, help="tasks of features and matching [%(default)s]")
    add("--cpus", type=int, default=1, help="processors of each task [%(default)s]")
    add("--redo", choices=list(STAGES), help="computes this stage and the later ones again")
    add("--json", action="store_true", help="prints the report as JSON")
    options = parser.add_argument_group("options of the program, as in `tiepoint reconstruct`")
    for command in STAGES.values():
        lines = [line.partition(": ") for line in (command.__doc__ or "").splitlines()]
        helps = {name: text.replace("%", "%%") for name, _, text in lines}
        for name, parameter in inspect.signature(command).parameters.items():
            flag = f"--{name.replace('_', '-')}"
            if name not in NOT_OPTIONS and flag not in parser._option_string_actions:
                kind: dict[str, Any] = {"metavar": "VALUE"}
                if parameter.default is False:
                    kind = {"action": "store_true"}
                options.add_argument(flag, help=helps.get(name), **kind)
    return parser


def main() -> int:
    arguments = vars(parser_of().parse_args())
    is_json = arguments.pop("json")
    given = {name: value for name, value in arguments.items() if value not in (None, False)}
    try:
        # Ray prints what happens to nodes.
        with contextlib.redirect_stdout(sys.stderr):
            report = reconstruct(given.pop("inputs"), given.pop("output"), **given)
    except (tiepoint.Error, tiepoint.UsageError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2 if isinstance(error, tiepoint.UsageError) else 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        return 130
    print(json.dumps(report) if is_json else text_of(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
