#!/usr/bin/env python3
"""`--rig auto` beside `off` and an oracle on synthetic features, under each disturbance.

  cargo build --release -p tiepoint-sfm --example rig_grid
  python bench/rig_modes.py run --seeds 101-112 [--routes open loop split] [--rates 2.5 5]
                                [--minutes 60] [--example PROGRAM]
  python bench/rig_modes.py table

`run` appends every result to --results at once and goes on where it ended; --minutes stops it. A
unit is all cells and modes of one seed, route and rate (`rig_grid`). `table` pools ln(ATE auto /
ATE off) over pairs of runs: its mean with a one-sided bound of 95 % (bootstrap over seeds, since
the cells of a seed share the street), over all cells and over those in which the oracle gains less
than 5 %; the share of the oracle's gain where it gains 20 % or more; and the cells in which `auto`
is worse after Holm's correction (one-sided sign-flip test over seeds). A run with less than 90 % of
the images has no error; pairs without both are told."""

import argparse
import itertools
import json
import math
import random
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

from program import ROOT

DRAWS = 10_000
MIN_SHARE = 0.9
# Of the oracle's gain, in ln: cells without and with something to gain.
NO_GAIN, GAIN = -math.log(0.95), -math.log(0.8)


def read(path):
    lines = path.read_text().splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def run(arguments):
    done = {(r["route"], r["rate_hz"], r["seed"]) for r in read(arguments.results)}
    end = time.monotonic() + 60 * arguments.minutes
    for seed, route, rate in itertools.product(
        arguments.seeds, arguments.routes, arguments.rates
    ):
        if (route, rate, seed) in done:
            continue
        if time.monotonic() > end:
            print("time is over: call again to go on")
            return
        words = [arguments.example, route, rate, seed, seed]
        lines = subprocess.run(
            [str(word) for word in words], check=True, capture_output=True, text=True
        ).stdout
        with open(arguments.results, "a") as out:
            out.write(lines)
        print(
            f"{route}, {rate} Hz, seed {seed}: {len(lines.splitlines())} runs",
            flush=True,
        )


def bound(by_seed, draws=DRAWS):
    """Mean over all values, and the one-sided upper bound of 95 %, of lists by seed."""
    lists, rng = list(by_seed.values()), random.Random(0)
    mean = statistics.mean(itertools.chain(*lists))
    if len(lists) < 3:
        return mean, None
    means = sorted(
        statistics.mean(itertools.chain(*rng.choices(lists, k=len(lists))))
        for _ in range(draws)
    )
    return mean, means[int(0.95 * draws)]


def sign_flip(values):
    """One-sided p that the mean is above zero, by all changes of sign."""
    if len(values) > 16:
        raise ValueError("too many seeds for all changes of sign")
    total = sum(values)
    signs = itertools.product((-1, 1), repeat=len(values))
    above = sum(
        sum(s * v for s, v in zip(sign, values, strict=True)) >= total for sign in signs
    )
    return above / 2 ** len(values)


def percent(log):
    return f"{100 * (math.exp(log) - 1):+.1f} %"


def table(arguments):
    runs = defaultdict(dict)
    for r in read(arguments.results):
        whole = r.get("registered", 0) >= MIN_SHARE * r.get("images", 1)
        runs[r["route"], r["rate_hz"], r["cell"], r["seed"]][r["mode"]] = (
            r["ate_cm"] if "ate_cm" in r and whole else None
        )
    cells = defaultdict(list)
    missing = 0
    for (route, rate, cell, seed), ate in runs.items():
        if any(ate.get(mode) is None for mode in ("off", "auto", "oracle")):
            missing += 1
            continue
        cells[route, rate, cell].append((seed, ate["off"], ate["auto"], ate["oracle"]))
    if not cells:
        sys.exit(f"{arguments.results} has no complete runs")

    def pool(of):
        by_seed = defaultdict(list)
        for key in of:
            for seed, off, auto, _ in cells[key]:
                by_seed[seed].append(math.log(auto / off))
        mean, upper = bound(by_seed)
        above = "" if upper is None else f", upper bound {upper:+.4f}"
        return f"mean {mean:+.4f}{above} ({percent(mean)}, {len(of)} cells, {len(by_seed)} seeds)"

    oracle = {
        key: statistics.mean(math.log(oracle / off) for _, off, _, oracle in values)
        for key, values in cells.items()
    }
    print(f"ln(auto / off), all cells: {pool(list(cells))}")
    if none := [key for key in cells if oracle[key] > -NO_GAIN]:
        print(f"where the oracle gains less than 5 %: {pool(none)}")
    if some := [key for key in cells if oracle[key] <= -GAIN]:
        gained = sum(
            statistics.mean(math.log(auto / off) for _, off, auto, _ in cells[key])
            for key in some
        )
        share = gained / sum(oracle[key] for key in some)
        print(
            f"share of its gain where it is 20 % or more: {share:.2f} ({len(some)} cells)"
        )
    tests = sorted(
        (sign_flip([math.log(auto / off) for _, off, auto, _ in values]), key)
        for key, values in cells.items()
    )
    worse = []
    for rank, (p, key) in enumerate(tests):
        if p * (len(tests) - rank) > 0.05:
            break
        worse.append(key)
    print(
        f"worse after Holm: {worse or 'none'}; smallest p {tests[0][0]:.3f} {tests[0][1]}"
    )
    print(f"runs without an error in some mode: {missing}\n")
    print("| route, rate | cell | seeds | off, cm | auto / off | oracle / off |")
    print("|---|---|---|---|---|---|")
    for key, values in cells.items():
        off = math.exp(statistics.mean(math.log(off) for _, off, _, _ in values))
        auto = math.exp(
            statistics.mean(math.log(auto / off) for _, off, auto, _ in values)
        )
        print(
            f"| {key[0]}, {key[1]} Hz | {key[2]} | {len(values)} | {off:.2f} | {auto:.2f} | "
            f"{math.exp(oracle[key]):.2f} |"
        )


def seeds(text):
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["run", "table"])
    parser.add_argument("--seeds", type=seeds, default=seeds("101-112"))
    parser.add_argument("--routes", nargs="+", default=["open", "loop", "split"])
    parser.add_argument("--rates", nargs="+", type=float, default=[2.5, 5.0])
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument(
        "--example", type=Path, default=ROOT / "target/release/examples/rig_grid"
    )
    parser.add_argument(
        "--results", type=Path, default=ROOT / "bench/results/rig-modes.jsonl"
    )
    arguments = parser.parse_args()
    arguments.results.parent.mkdir(parents=True, exist_ok=True)
    {"run": run, "table": table}[arguments.what](arguments)


if __name__ == "__main__":
    main()
