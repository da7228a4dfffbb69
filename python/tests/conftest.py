"""A drive that the program renders, and its model."""

import pytest
import tiepoint


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive") / "drive"
    tiepoint.synth(folder, route="open", length=40, rate=1.5, size="400x300")
    return folder


@pytest.fixture(scope="session")
def workspace(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("model") / "ws"
    # Tests hold and remove single images, which those of a rig are not.
    tiepoint.reconstruct(drive, folder, rig="off")
    return folder
