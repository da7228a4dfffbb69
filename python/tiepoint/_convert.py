"""Conversion to and from pycolmap."""

import tempfile

from ._tiepoint import Reconstruction


def to_pycolmap(reconstruction):
    """The model as a `pycolmap.Reconstruction`; needs the package pycolmap."""
    import pycolmap

    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write(folder)
        return pycolmap.Reconstruction(folder)


def from_pycolmap(reconstruction):
    """The model of a `pycolmap.Reconstruction`."""
    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write(folder)
        return Reconstruction(folder)
