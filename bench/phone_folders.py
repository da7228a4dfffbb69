#!/usr/bin/env python3
"""Phone folders: photos as people have them, made of sets that are measured.

    pip install numpy pillow pycolmap==4.2.1
    cargo build --release
    TIEPOINT_DATA=... python bench/phone_folders.py    all folders, tiepoint and COLMAP
    TIEPOINT_DATA=... python bench/phone_folders.py [--only tiepoint] [--sets SET] [--folders zoom]

Each folder is made of all photos of a set, encoded again as JPEG of quality 97 (the folder `clean`,
too), with EXIF data of a phone whose 35 mm equivalent focal length is rounded to a millimetre:

    clean         as they are
    flag          a third with pixels turned by 90° and the orientation flag that turns them back
    upright       a third with the flag of a phone held upright: read turned by 90°
    turned        a third with pixels turned by 90° and no flag
    crops, halves a third cropped about the centre to 75 %; a third of half the size
    mixed         both: a third cropped, another third of half the size
    zoom          a third cropped to 2/3 and resampled to full size, with 1.5 times the focal length
    phones        half by a second phone: another body, cropped to 4:3 and resampled to 80 %
    distractors   a tenth more photos, of another place

The error is the mean distance of the camera centres from the truth of Strecha et al. after a
similarity (Umeyama 1991), in millimetres; where there is none (sceaux), from the same program's
model of the clean folder with the first seed, in thousandths of the extent of its centres. `focal`
is the largest relative error of a focal length, of the known K with what was done to the photos.
COLMAP has its defaults (one camera a size and EXIF, its mode AUTO)."""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from colmap import strecha_centres, umeyama
from PIL import ExifTags, Image
from program import program_of

# Diagonal of 35 mm film, which the equivalent focal length refers to (CIPA DCG-001).
FILM_DIAGONAL_MM = float(np.hypot(36, 24))
QUALITY = 97
CROP, HALF, ZOOM, SECOND = 0.75, 0.5, 1.5, 0.8
FOLDERS = [
    "clean", "flag", "upright", "turned", "crops", "halves", "mixed", "zoom", "phones",
    "distractors",
]  # fmt: skip
SETS = {"fountain-P11": "sceaux", "sceaux": "fountain-P11"}


def exif_of(focal_mm, focal_px, size, model, orientation=1):
    exif = Image.Exif()
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = "Bench", model
    exif[ExifTags.Base.Orientation] = orientation
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.FocalLength] = focal_mm
    equivalent = round(focal_px / float(np.hypot(*size)) * FILM_DIAGONAL_MM)
    details[ExifTags.Base.FocalLengthIn35mmFilm] = equivalent
    return exif


def centre_box(size, width, height):
    x, y = (size[0] - width) // 2, (size[1] - height) // 2
    return (x, y, x + width, y + height)


def make(kind, index, image, focal_px):
    """The photo, its EXIF data and its focal length in pixels."""
    size = image.size
    is_first, is_second = index % 3 == 1, index % 3 == 2
    plain = exif_of(5.0, focal_px, size, "One")
    if kind == "flag" and is_first:
        return image.transpose(Image.Transpose.ROTATE_90), with_flag(plain, 6), focal_px
    if kind == "upright" and is_first:
        return image, with_flag(plain, 6), focal_px
    if kind == "turned" and is_first:
        return image.transpose(Image.Transpose.ROTATE_90), plain, focal_px
    if kind in ("crops", "mixed") and is_first:
        sides = [round(CROP * side) for side in size]
        return image.crop(centre_box(size, *sides)), plain, focal_px
    if kind == "halves" and is_first or kind == "mixed" and is_second:
        half = image.resize([round(HALF * side) for side in size], Image.Resampling.LANCZOS)
        return half, plain, HALF * focal_px
    if kind == "zoom" and is_first:
        box = centre_box(size, *(round(side / ZOOM) for side in size))
        zoomed = image.crop(box).resize(size, Image.Resampling.LANCZOS)
        ratio = size[0] / (box[2] - box[0])
        return zoomed, exif_of(5.0 * ZOOM, ratio * focal_px, size, "One"), ratio * focal_px
    if kind == "phones" and index % 2 == 1:
        width = min(size[0], size[1] * 4 // 3)
        cropped = image.crop(centre_box(size, width, min(size[1], width * 3 // 4)))
        sides = [round(SECOND * side) for side in cropped.size]
        focal = sides[0] / cropped.size[0] * focal_px
        second = cropped.resize(sides, Image.Resampling.LANCZOS)
        return second, exif_of(4.2, focal, sides, "Two"), focal
    return image, plain, focal_px


def with_flag(exif, orientation):
    exif[ExifTags.Base.Orientation] = orientation
    return exif


def photos_of(folder):
    return sorted(p for p in folder.iterdir() if p.suffix.lower() == ".jpg")


def write_folder(kind, data, name, target):
    """Writes a folder; the focal length in pixels of each photo."""
    target.mkdir(parents=True)
    focal_px = np.loadtxt(data / name / "K.txt")[[0, 1], [0, 1]].mean()
    focals = {}
    for index, path in enumerate(photos_of(data / name / "images")):
        image = Image.open(path).convert("RGB")
        image, exif, focals[path.name] = make(kind, index, image, focal_px)
        image.save(target / path.name, quality=QUALITY, subsampling=0, exif=exif)
    if kind == "distractors":
        others = photos_of(data / SETS[name] / "images")
        for path in others[:: max(1, len(others) // round(0.1 * len(focals) + 0.5))]:
            Image.open(path).convert("RGB").save(
                target / f"stranger_{path.name}", quality=QUALITY, subsampling=0
            )
    return focals


def run_tiepoint(program, photos, scratch, seed):
    workspace = scratch / "tiepoint"
    # Later seeds map the matches of the first.
    verb = ["map", workspace, "--redo", "map"]
    if not workspace.exists():
        verb = ["reconstruct", photos, "-o", workspace]
    command = [program, *verb, "--seed", seed, "--json"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if done.returncode != 0:
        print(done.stderr.strip().splitlines()[-1], file=sys.stderr)
        return None
    return workspace / "sparse/0"


def run_colmap(photos, scratch, seed):
    import pycolmap

    pycolmap.logging.minloglevel = 2
    database = scratch / "colmap.db"
    if not database.exists():
        pycolmap.extract_features(database, photos, camera_mode=pycolmap.CameraMode.AUTO)
        pycolmap.match_exhaustive(database)
    options = pycolmap.IncrementalPipelineOptions(random_seed=seed)
    sparse = scratch / f"colmap-{seed}"
    sparse.mkdir()
    models = pycolmap.incremental_mapping(database, photos, sparse, options)
    if not models:
        return None
    best = max(models, key=lambda index: models[index].num_reg_images())
    return sparse / str(best)


def centres_of(model):
    images = [image for image in model.images.values() if image.has_pose]
    return {image.name: image.projection_center() for image in images}


def measure(path, focals, truth, unit):
    """Registered photos, error against the truth, largest relative error of a focal length."""
    import pycolmap

    if path is None:
        return {"registered": 0, "photos": len(focals)}
    model = pycolmap.Reconstruction(path)
    centres = centres_of(model)
    names = sorted(set(centres) & set(truth))
    out = {
        "registered": sum(name in focals for name in centres),
        "photos": len(focals),
        "distractors": sum(name not in focals for name in centres),
        "cameras": len(model.cameras),
    }
    if len(names) > 3:
        found = np.array([centres[name] for name in names])
        true = np.array([truth[name] for name in names])
        scale, rotation, translation = umeyama(found, true)
        errors = np.linalg.norm(scale * found @ rotation.T + translation - true, axis=1)
        out["error"] = float(unit * errors.mean())
    ratios = [
        model.cameras[image.camera_id].mean_focal_length() / focals[image.name]
        for image in model.images.values()
        if image.has_pose and image.name in focals
    ]
    out["focal"] = float(np.abs(np.array(ratios) - 1).max())
    return out


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", nargs="*", default=list(SETS))
    parser.add_argument("--folders", nargs="*", default=FOLDERS)
    parser.add_argument("--only", choices=["tiepoint", "colmap"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--program", type=Path)
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    data = Path(os.environ["TIEPOINT_DATA"])
    programs = [arguments.only] if arguments.only else ["colmap", "tiepoint"]
    runs = []
    for name in arguments.sets:
        cameras = data / name / "cameras"
        truths = {}
        for kind in ["clean", *(kind for kind in arguments.folders if kind != "clean")]:
            with tempfile.TemporaryDirectory() as scratch:
                scratch = Path(scratch)
                focals = write_folder(kind, data, name, scratch / "photos")
                for program in programs:
                    for seed in range(arguments.seeds):
                        if program == "tiepoint":
                            own = program_of(arguments)
                            path = run_tiepoint(own, scratch / "photos", scratch, seed)
                        else:
                            path = run_colmap(scratch / "photos", scratch, seed)
                        if cameras.is_dir():
                            truth, unit = strecha_centres(cameras), 1000.0
                        else:
                            if program not in truths:
                                import pycolmap

                                truths[program] = centres_of(pycolmap.Reconstruction(path))
                            truth = truths[program]
                            spread = np.array(list(truth.values()))
                            unit = 1000.0 / float(np.linalg.norm(np.ptp(spread, axis=0)))
                        found = measure(path, focals, truth, unit)
                        run = {"set": name, "folder": kind, "program": program, "seed": seed}
                        runs.append(run | found)
                        print(runs[-1], flush=True)
    if arguments.results:
        arguments.results.write_text(json.dumps({"runs": runs}, indent=1) + "\n")


if __name__ == "__main__":
    main()
