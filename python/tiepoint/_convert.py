"""Conversion to pycolmap."""

import tempfile


def to_pycolmap(reconstruction):
    """The model as a `pycolmap.Reconstruction`; needs the package pycolmap."""
    import pycolmap

    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write(folder)
        return pycolmap.Reconstruction(folder)
