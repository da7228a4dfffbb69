#!/usr/bin/env python3
"""Types README.md out, as a newcomer would: in a clone, with an empty home.

    release/try_readme.py [--built PROGRAM WHEEL] [--within FOLDER]

Runs every line of its `sh` blocks, every command in its table of wishes, and its Python, and stops
at the first one that fails. PHOTOS are a drive that the program renders. Without --built it
compiles three times what README says to compile, with no cache of crates, which takes a Rust
toolchain, a C compiler, musl-gcc, and an hour on a laptop. With --built, these three lines are left
out, and PROGRAM and WHEEL, as `release/package` and `release/wheel` make them, take their place.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

# The start of the lines that compile.
COMPILING = ("cargo install", "pip install", "release/package")
# Rows whose command needs what a rendered drive has not.
LEFT_OUT = ("--calibration FILE",)
# The words in capitals, and what is typed for them; DIR is a new folder each time.
PLACES = {"PHOTOS": "photos", "WORKSPACE": "workspace"}
# What a newcomer has not set; the rest may be what this machine needs for the network.
UNSET = ("CARGO_HOME", "CARGO_TARGET_DIR", "RUSTFLAGS", "PYTHONPATH", "VIRTUAL_ENV")


def commands(readme: str) -> list[str]:
    """The commands of README in their order: blocks first, then rows of the table."""
    blocks = re.findall(r"```sh\n(.*?)```", readme, re.S)
    lines = [line.split(" #")[0].strip() for block in blocks for line in block.splitlines()]
    table = readme.split("| I want | command |")[1].split("\n\n")[0]
    for row in table.splitlines()[2:]:
        first = re.match(r"`([^`]*)`", row.strip("| ").split(" | ", 1)[1])
        if first and first[1] not in LEFT_OUT:
            # An option is one of `reconstruct`.
            is_option = first[1].startswith("--")
            lines.append(f"tiepoint reconstruct drive -o DIR {first[1]}" if is_option else first[1])
    return [line for line in lines if line]


def main() -> None:
    parser = argparse.ArgumentParser(description="Types README.md out")
    parser.add_argument("--built", type=Path, nargs=2, metavar=("PROGRAM", "WHEEL"))
    parser.add_argument("--within", type=Path, help="where a folder is made for it")
    options = parser.parse_args()
    repository = Path(__file__).resolve().parent.parent
    root = Path(tempfile.mkdtemp(prefix="readme-", dir=options.within)).resolve()
    clone, home = root / "tiepoint", root / "home"
    (home / "bin").mkdir(parents=True)
    subprocess.run(["git", "clone", "--quiet", repository, clone], check=True)
    subprocess.run([sys.executable, "-m", "venv", home / "venv"], check=True)
    folders = [home / "bin", home / "venv/bin", home / ".cargo/bin", os.environ["PATH"]]
    environment = {key: value for key, value in os.environ.items() if key not in UNSET}
    environment |= {"HOME": str(home), "PATH": ":".join(map(str, folders))}
    rustup = Path(os.environ.get("HOME", "/"), ".rustup")
    environment.setdefault("RUSTUP_HOME", str(rustup))
    if options.built:
        program, wheel = (path.resolve() for path in options.built)
        shutil.copy(program, home / "bin/tiepoint")

    def run(line: str) -> None:
        print(f"$ {line}", flush=True)
        done = subprocess.run(["bash", "-ec", line], cwd=clone, env=environment, check=False)
        if done.returncode != 0:
            sys.exit(f"exit code {done.returncode} of: {line}; the folder is {root}")

    if options.built:
        run(f"pip install --quiet '{wheel}'")
    readme = (clone / "README.md").read_text(encoding="utf-8")
    for number, line in enumerate(commands(readme)):
        if options.built and line.startswith(COMPILING):
            print(f"left out: {line}", flush=True)
            continue
        for word, place in (PLACES | {"DIR": f"folder-{number}"}).items():
            line = re.sub(rf"\b{word}\b", place, line)
        if "photos" in line and not (clone / "photos").exists():
            run("tiepoint synth -o drive --frames 12 --size 320x240")
            run("cp -r drive/left photos")
        run(line)
    python = re.search(r"```python\n(.*?)```", readme, re.S)
    assert python, "README.md has no Python"
    # Another workspace: that of the commands is complete.
    (home / "readme.py").write_text(python[1].replace('"workspace"', '"workspace-python"'))
    run(f"python3 {home}/readme.py")
    shutil.rmtree(root)
    print("README.md can be typed out")


if __name__ == "__main__":
    main()
