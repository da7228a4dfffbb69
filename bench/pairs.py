#!/usr/bin/env python3
"""Pairs of photos in no order: how many are chosen, how many true pairs are among them, and how
long it takes, by `--pairs auto` and by COLMAP's vocabulary tree, on the same features in one run.

    pip install numpy pycolmap==4.2.1
    cargo build --release
    cargo build --release -p tiepoint-synth --example unordered
    cargo build --release -p tiepoint-pipeline --example choose
    python bench/pairs.py [--photos 1000] [--seed 1] [--folder KEPT]

`unordered` renders the photos of five cameras on one and a half loops around a block, in random
order. A true pair has at least 30 common points by the ground truth. COLMAP's tree is learnt from
descriptors of the photos themselves, as ours (`VisualIndex.build` with its defaults, but as many
words as ours and 10 iterations); its pairs are those of its vocab_tree_matcher with its defaults
(100 photos, 5 nearest words). `similar:100` is the retrieval by global descriptors, all photos with
all. Memory is the peak of a process that does nothing else."""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from program import TARGET, program_of

MIN_POINTS = 30
SELECTIONS = ["auto", "similar:100", "exhaustive"]
# Descriptors of a photo that are used, for each word, and in the sample for each word: as in
# crates/pipeline/src/stages/pair_choice.rs.
LEADING, PER_WORD, SAMPLE_PER_WORD = 1000, 128, 8
ITERATIONS = 10


def example(name):
    path = TARGET / "release/examples" / name
    if not path.exists():
        sys.exit(f"{path} is not there: see the head of bench/pairs.py")
    return path


def run(*words):
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}: {done.stderr.strip().splitlines()[-1]}")
    return done.stdout


def pairs_of(text, skipped=0):
    lines = [line.split(",") for line in text.splitlines()[skipped:]]
    return {tuple(sorted(line[:2])): line for line in lines}


def colmap(workspace, seed):
    """Pairs of COLMAP's vocabulary tree; run in a process of its own."""
    import pycolmap

    sift = pycolmap.FeatureExtractorType.SIFT
    with pycolmap.Database.open(workspace / "database.db") as database:
        images = {image.image_id: image.name for image in database.read_all_images()}
        counts = [min(database.num_descriptors_for_image(i), LEADING) for i in images]
        words = -(-sum(counts) // PER_WORD)
        each = -(-SAMPLE_PER_WORD * words // len(images))
        start = time.perf_counter()
        random, sample = np.random.default_rng(seed), []
        for image in images:
            data = np.asarray(database.read_descriptors(image).data)[:LEADING]
            chosen = random.permutation(len(data))[:each]
            sample.append(data[np.sort(chosen)].astype(np.float32))
        sample = pycolmap.FeatureDescriptorsFloat(sift, np.concatenate(sample))
        options = pycolmap.VisualIndex.BuildOptions()
        options.num_visual_words, options.num_iterations = words, ITERATIONS
        index = pycolmap.VisualIndex.create(128, 64)
        index.build(options, sample)
        tree = workspace / "tree.bin"
        index.write(tree)
        learn_s = time.perf_counter() - start
        start = time.perf_counter()
        options = pycolmap.VocabTreePairingOptions()
        options.vocab_tree_path = tree
        options.max_num_features = LEADING
        found = pycolmap.VocabTreePairGenerator(options, database).all_pairs()
        seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    names = sorted({tuple(sorted((images[a], images[b]))) for a, b in found if a != b})
    print(json.dumps({"seconds": learn_s + seconds, "peak_mib": peak, "pairs": names}))


def measure(arguments, scratch):
    folder = arguments.folder or scratch / "photos"
    if not (folder / "truth.csv").exists():
        run(example("unordered"), folder, arguments.photos, arguments.seed)
    listed = pairs_of((folder / "truth.csv").read_text(), 1)
    truth = {pair for pair, line in listed.items() if int(line[2]) >= MIN_POINTS}
    photos = len(list((folder / "photos").iterdir()))
    workspace = scratch / "ws"
    run(program_of(arguments), "features", folder / "photos", "-o", workspace)
    runs = []

    def add(method, selection, pairs, found):
        both = len(truth & pairs)
        runs.append(
            {
                "method": method,
                "selection": selection,
                "photos": photos,
                "true_pairs": len(truth),
                "pairs": len(pairs),
                "recall": both / len(truth),
                "precision": both / len(pairs),
                "seconds": found["seconds"],
                "peak_mib": found["peak_mib"],
            }
        )
        print(runs[-1], flush=True)

    for selection in SELECTIONS:
        chosen = scratch / "chosen.csv"
        found = json.loads(run(example("choose"), workspace, selection, chosen))
        add(f"tiepoint, {selection}", found["selection"], set(pairs_of(chosen.read_text())), found)
    words = [sys.executable, __file__, "--colmap", workspace, "--seed", arguments.seed]
    found = json.loads(run(*words).splitlines()[-1])
    add("COLMAP, vocabulary tree", "100", {tuple(pair) for pair in found["pairs"]}, found)
    return runs


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photos", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="of photos that are there, or are kept")
    parser.add_argument("--program", type=Path)
    parser.add_argument("--results", type=Path, help="writes the raw results as JSON")
    parser.add_argument("--colmap", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.colmap:
        colmap(arguments.colmap, arguments.seed)
        return
    with tempfile.TemporaryDirectory() as scratch:
        runs = measure(arguments, Path(scratch))
    if arguments.results:
        arguments.results.write_text(json.dumps(runs))


if __name__ == "__main__":
    main()
