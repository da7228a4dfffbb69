"""What the scripts beside this share: which `tiepoint` they measure, and the angle of a cosine."""

import math
import os
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


def degrees(cosine):
    """Of a cosine that rounding may have taken past 1."""
    return math.degrees(math.acos(min(max(cosine, -1), 1)))
