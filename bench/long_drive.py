#!/usr/bin/env python3
"""Time and memory of a step of bundle adjustment by the length of the drive: with the rig's
factors, without, and with the loop closed.

    cargo build --release -p tiepoint-ba --example drive
    python bench/long_drive.py [--variant rig|none|loop ...] [--repetitions 1] \\
        [--svg docs/drive.svg] [--results RESULTS.json]

The results of variants that are run apart are gathered in RESULTS.json; of repetitions the quickest
counts. A step's time is the median from the end of one step to that of the next, and, beside it,
that of the whole solve over the number of steps: the first step also pays for memory that is new,
at a price that virtual machines set by the hour."""

import argparse
import json
import pathlib
import re
import subprocess

from program import TARGET

FRAMES = [250, 500, 1000, 2000]
VARIANTS = {"rig": [], "none": ["--no-rig"], "loop": ["--loop"]}
NAMES = {"rig": "with the rig's factors", "none": "without", "loop": "loop closed"}
COLOURS = {"rig": "#1b6ca8", "none": "#d1495b", "loop": "#3a7d44"}
LINE = re.compile(
    r"(\d+) cameras, (\d+) factors: analysis ([\d.]+) s, ([\d.]+) s a step \(median ([\d.]+)\);"
    r" ([\d.]+) GiB"
)


def run(frames, flags):
    out = subprocess.run(
        [TARGET / "release/examples/drive", str(frames), "500", *flags],
        check=True,
        capture_output=True,
        text=True,
    )
    cameras, factors, analysis, mean, step, gib = LINE.search(out.stdout).groups()
    return dict(
        cameras=int(cameras),
        factors=int(factors),
        analysis_s=float(analysis),
        step_s=float(step),
        mean_s=float(mean),
        gib=float(gib),
    )


def svg(results):
    """Seconds on the left axis in lines, GiB on the right one in dashes."""
    most_s, most_gib = 1.25, 3.75
    at = lambda cameras: 60 + 400 * cameras / 4200
    line = lambda y, most: 230 - 200 * y / most
    parts = [
        (
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 520 270" font-family="sans-serif"'
            ' font-size="11">'
        ),
        '<rect width="520" height="270" fill="#fff"/>',
        '<path d="M60 30V230H460V30" fill="none" stroke="#888"/>',
    ]
    parts += [
        f'<text x="54" y="{line(y, most_s) + 4:.0f}" text-anchor="end">{y}</text>'
        for y in (0.5, 1.0)
    ]
    parts += [f'<text x="466" y="{line(y, most_gib) + 4:.0f}">{y}</text>' for y in (1, 2, 3)]
    parts += [
        f'<text x="{at(2 * n):.0f}" y="246" text-anchor="middle">{2 * n}</text>' for n in FRAMES
    ]
    parts += [
        '<text x="260" y="262" text-anchor="middle">cameras</text>',
        '<text x="60" y="22" text-anchor="middle">s a step</text>',
        '<text x="460" y="22" text-anchor="middle">GiB (dashed)</text>',
    ]
    for row, (variant, runs) in enumerate(results.items()):
        for key, most, dashes in (
            ("step_s", most_s, ""),
            ("gib", most_gib, ' stroke-dasharray="4 3"'),
        ):
            path = "M" + "L".join(f"{at(r['cameras']):.1f} {line(r[key], most):.1f}" for r in runs)
            parts.append(
                f'<path d="{path}" fill="none" stroke="{COLOURS[variant]}"'
                f' stroke-width="1.5"{dashes}/>'
            )
        parts.append(
            f'<text x="76" y="{44 + 14 * row}" fill="{COLOURS[variant]}">{NAMES[variant]}</text>'
        )
    return "\n".join(parts) + "\n</svg>\n"


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--variant", nargs="*", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--repetitions", type=int, default=1)
    parser.add_argument("--svg", type=pathlib.Path)
    parser.add_argument("--results", type=pathlib.Path)
    options = parser.parse_args()
    results = (
        json.loads(options.results.read_text())
        if options.results and options.results.exists()
        else {}
    )
    for variant in options.variant:
        results[variant] = [
            min(
                (run(n, VARIANTS[variant]) for _ in range(options.repetitions)),
                key=lambda r: r["step_s"],
            )
            for n in FRAMES
        ]
    if options.results:
        options.results.write_text(json.dumps(results, indent=1))
    for variant, runs in results.items():
        for r in runs:
            print(
                f"{variant:5} {r['cameras']:5} cameras {r['factors']:8} factors:"
                f" {r['analysis_s']:.2f} s analysis, {r['step_s']:.3f} s a step, {r['mean_s']:.3f}"
                f" over all, {r['gib']:.2f} GiB"
            )
    if options.svg:
        options.svg.write_text(svg(results))


if __name__ == "__main__":
    main()
