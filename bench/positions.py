#!/usr/bin/env python3
"""What measured positions of the photos do: drives of keypoints with their truth, and photos with
positions in EXIF.

    cargo build --release -p tiepoint -p tiepoint-sfm --example positions --bin tiepoint
    python bench/positions.py drives [--length 600] [--seeds 5] [--clock]
    python bench/positions.py photos FOLDER

`drives` prints the table of the example `positions`: the root mean square distance of the cameras
from the truth, without positions in the adjustments, with them, and of what is kept; with `--clock`
the errors of the clock offset and the lever arm of tracks, beside their deviations. `photos`
reconstructs a folder without positions, then with them, and prints what the program says of them,
and of both models the photos, the reprojection error and the time of mapping."""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

from program import TARGET, program_of


def drives(args):
    example = TARGET / "release/examples/positions"
    arguments = ["--length", str(args.length), "--seeds", str(args.seeds)]
    arguments += ["--clock", "1"] if args.clock else []
    subprocess.run([example, *arguments], check=True)


def photos(args):
    program = program_of(args)
    with tempfile.TemporaryDirectory() as folder:
        workspace = Path(folder) / "ws"
        run = [program, "reconstruct", args.folder, "-o", workspace, "--json"]
        for priors in ["off", "auto"]:
            command = [*run, "--position-priors", priors, "--redo", "map"]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            report = json.loads(done.stdout)
            model, stage = report["models"][0], report["stages"]["map"]
            print(
                f"{priors}: {model['registered']} of {model['images']} photos,"
                f" {model['mean_reprojection_error_px']:.4f} px, {stage['seconds']:.1f} s"
            )
            for note in stage.get("notes", []):
                print(f"  {note}")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("drives")
    command.add_argument("--length", type=float, default=600)
    command.add_argument("--seeds", type=int, default=5)
    command.add_argument("--clock", action="store_true", help="tracks with a clock of their own")
    command.set_defaults(run=drives)
    command = commands.add_parser("photos")
    command.add_argument("folder")
    command.add_argument("--program", type=Path, help="by default that of the release build")
    command.set_defaults(run=photos)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
