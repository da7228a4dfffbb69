"""A small drive, rendered and reconstructed by the installed package: what a wheel must do before
it is given away."""

import tempfile
from pathlib import Path

import tiepoint

with tempfile.TemporaryDirectory() as folder:
    folder = Path(folder)
    tiepoint.synth(folder / "drive", frames=8, rate=2.5)
    report = tiepoint.reconstruct(folder / "drive", folder / "ws", pairs="sequential:4")
    model = tiepoint.Reconstruction.read(folder / "ws")
    assert len(model.image_names) == report["models"][0]["registered"] > 8, report["models"]
    assert len(model.points) > 100
    tiepoint.export(folder / "ws", to="ply", output=folder / "points.ply")
    print(tiepoint.__version__, len(model.image_names), "images", len(model.points), "points")
