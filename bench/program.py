"""What the scripts beside this share: which `tiepoint` they measure, how they call it, and an
angle from its cosine."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))


def program_of(arguments=None):
    """What `--program` says, if there is one, else the release build."""
    program = getattr(arguments, "program", None) or TARGET / "release/tiepoint"
    if not program.exists():
        sys.exit(f"{program} is not there: cargo build --release")
    return program


def tiepoint(*words):
    """Runs the program; what it prints as JSON. A failure ends the script with its sentence."""
    command = [str(word) for word in (program_of(), *words, "--json")]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout)


def kitti_intrinsics(folder):
    """fx, fy, cx and cy of the left camera of a KITTI clip."""
    # The first line is `P0:` and twelve numbers; the name is left out in some files.
    first = (Path(folder) / "calib.txt").read_text().splitlines()[0].split()[-12:]
    k = [float(value) for value in first]
    # The centre of the first pixel is (0, 0) in KITTI's files.
    return k[0], k[5], k[2] + 0.5, k[6] + 0.5


def degrees(cosine):
    """Of a cosine that rounding may have taken past 1."""
    return math.degrees(math.acos(min(max(cosine, -1), 1)))
