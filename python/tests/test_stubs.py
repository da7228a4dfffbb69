"""The type stubs."""

import pathlib
import sys

import pytest
import tiepoint

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))


def test_stubs_are_those_of_the_commands():
    stubs = pytest.importorskip("stubs")
    assert stubs.STUBS.read_text(encoding="utf-8") == stubs.text(), "run python python/stubs.py"


def test_stubs_name_everything():
    text = (ROOT / "tiepoint/__init__.pyi").read_text(encoding="utf-8")
    for name in tiepoint.__all__:
        assert f"def {name}(" in text or f"class {name}" in text or f"{name}:" in text, name
