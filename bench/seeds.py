#!/usr/bin/env python3
"""The tests of the mapper on all their seeds.

    bench/seeds.py [FILTER ...]

`./check` maps each synthetic scene of crates/sfm/tests on the first seed of its grid alone; this
takes the whole grids, by TIEPOINT_ALL_SEEDS=1, with the same assertions: the shape of calibrated,
uncalibrated and precisely seen scenes and of those with keypoints that are off (mapper), clocks and
extrinsics with their uncertainty over all seeds (clocks) and with a lens field (deviations), lenses
(lens), facades that repeat (repetition), the paper's term (rig). FILTER chooses tests by a part of
their names."""

import os
import subprocess
import sys

from program import ROOT

sys.exit(
    subprocess.run(
        [
            "cargo",
            "test",
            "--release",
            "--locked",
            "-p",
            "tiepoint-sfm",
            "--test",
            "sfm",
            "--",
            *sys.argv[1:],
        ],
        cwd=ROOT,
        env={**os.environ, "TIEPOINT_ALL_SEEDS": "1"},
    ).returncode
)
