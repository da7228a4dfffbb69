#!/usr/bin/env python3
"""Licence texts of the packages that are compiled into the program, or into the Python package.

    release/licences.py TARGET [program | python]

MIT, BSD and Apache-2.0 ask for their texts beside the program. Cargo lists the packages; the texts
are in their sources, and beside the sources of others that our crates contain (three.js). Which
licences are allowed is checked by `cargo deny`.
"""

import json
import subprocess
import sys
from pathlib import Path

NAMES = ("LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "NOTICE", "UNLICENSE")


ROOT = Path(__file__).resolve().parent.parent
# Of what is given away: the manifest and the package.
GIVEN = {"program": ("Cargo.toml", "tiepoint"), "python": ("python/Cargo.toml", "tiepoint-python")}


def cargo(manifest, *arguments):
    command = ["cargo", *arguments, "--manifest-path", ROOT / manifest, "--locked"]
    command += ["--features", "las"]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def compiled_in(manifest, package, target):
    """Names and versions of the packages of a package on a target, without build tools."""
    tree = cargo(manifest, "tree", "-p", package, "-e", "normal", "--target", target,
                 "--prefix", "none", "--format", "{p}")
    packages = {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    return {(name, version.removeprefix("v")) for name, version in packages}


def licence_files(folder):
    found = [path for path in folder.iterdir()
             if path.is_file() and path.name.upper().startswith(NAMES)]
    return sorted(found, key=lambda path: path.name)


def contained(folder):
    """Licences beside sources of others in the folder of one of our packages."""
    found = [path for path in folder.joinpath("src").rglob("*") if path.name in NAMES]
    return sorted(found)


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit("usage: release/licences.py TARGET [program | python]")
    target, given = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "program"
    manifest, ours = GIVEN[given]
    wanted = compiled_in(manifest, ours, target)
    metadata = json.loads(cargo(manifest, "metadata", "--format-version", "1",
                                "--filter-platform", target))
    packages = [package for package in metadata["packages"]
                if (package["name"], package["version"]) in wanted]
    missing = wanted - {(package["name"], package["version"]) for package in packages}
    if missing:
        sys.exit(f"no sources of {sorted(missing)}: run `cargo fetch`")
    out = sys.stdout
    out.reconfigure(encoding="utf-8", newline="\n")
    out.write("The program contains these packages. Each is named with its licence, and with the\n"
              "texts that its sources have.\n")
    for package in sorted(packages, key=lambda package: (package["name"], package["version"])):
        # Our own packages have the licences beside this file.
        if package["source"] is None:
            for path in contained(Path(package["manifest_path"]).parent):
                text = path.read_text(encoding="utf-8")
                out.write(f"\n{'=' * 80}\n{path.parent.name}, in {package['name']}\n\n"
                          f"{text.strip()}\n")
            continue
        where = package["repository"] or "https://crates.io/crates/" + package["name"]
        out.write(f"\n{'=' * 80}\n{package['name']} {package['version']}: {package['license']}\n"
                  f"{where}\n")
        for path in licence_files(Path(package["manifest_path"]).parent):
            text = path.read_text(encoding="utf-8", errors="replace")
            out.write(f"\n--- {path.name}\n\n{text.strip()}\n")


if __name__ == "__main__":
    main()
