"""The commands of the program as functions."""

import _thread
import inspect
import multiprocessing
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import tiepoint

# Seconds in which Ctrl-C stops a command.
CTRL_C_LIMIT_S = 1.0
# Share of its speed that another thread keeps beside a command with one thread, if other processes
# take up to half of a processor. A held lock would leave nothing.
KEPT_SPEED = 0.3


def test_commands_have_the_options_of_the_program():
    assert {"reconstruct", "map_images", "evaluate_poses", "model_align"} <= set(
        tiepoint.commands()
    )
    parameters = inspect.signature(tiepoint.reconstruct).parameters
    assert list(parameters)[:2] == ["inputs", "output"]
    assert parameters["rig"].kind is inspect.Parameter.KEYWORD_ONLY
    assert "fix_existing_frames" in parameters and "progress" in parameters
    assert "rig:" in tiepoint.reconstruct.__doc__


def test_events_results_and_resume(drive, tmp_path):
    events = []
    report = tiepoint.reconstruct(drive, tmp_path / "ws", progress=events.append)
    kinds = {event["event"] for event in events}
    assert {"stage_began", "image_done", "pair_done", "stage_done"} <= kinds
    photos = list(drive.glob("*/*.png"))
    assert 2 < report["models"][0]["registered"] <= len(photos)
    again = []
    tiepoint.reconstruct(drive, tmp_path / "ws", progress=again.append)
    assert {event["event"] for event in again} == {"stage_kept"}


def test_errors_are_exceptions(drive, tmp_path):
    with pytest.raises(tiepoint.Error, match="absent"):
        tiepoint.reconstruct(tmp_path / "absent", tmp_path / "ws")
    with pytest.raises(tiepoint.UsageError, match="rig"):
        tiepoint.reconstruct(drive, tmp_path / "ws", rig="wrong")
    with pytest.raises(TypeError, match="no_such_option"):
        tiepoint.reconstruct(drive, tmp_path / "ws", no_such_option=1)
    with pytest.raises(tiepoint.UsageError, match="output"):
        tiepoint.reconstruct(drive)
    with pytest.raises(TypeError, match="workspace"):
        tiepoint.map_images()
    assert issubclass(tiepoint.UsageError, ValueError)


def test_an_exception_of_the_callback_stops_the_work(drive, tmp_path):
    def stop(event):
        if event["event"] == "pair_done":
            raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        tiepoint.reconstruct(drive, tmp_path / "ws", progress=stop)
    # What was done is kept.
    report = tiepoint.reconstruct(drive, tmp_path / "ws")
    assert report["models"]


def test_ctrl_c_stops_within_a_second(drive, tmp_path):
    began = threading.Event()

    def interrupt():
        began.wait()
        sent.append(time.monotonic())
        _thread.interrupt_main()

    sent = []
    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        tiepoint.reconstruct(drive, tmp_path / "ws", progress=lambda event: began.set())
    assert time.monotonic() - sent[0] < CTRL_C_LIMIT_S
    # The next call waits for the end of the stopped one, and resumes.
    assert tiepoint.reconstruct(drive, tmp_path / "ws")["models"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_forked_processes_are_refused(workspace):
    with multiprocessing.get_context("fork").Pool(1) as pool:
        with pytest.raises(tiepoint.Error, match="spawn"):
            pool.apply_async(tiepoint.sift, [np.zeros((64, 64), np.uint8)]).get(timeout=60)


def test_other_threads_go_on(drive, tmp_path):
    counts = [0]
    stop = threading.Event()

    def count():
        while not stop.is_set():
            for _ in range(1000):
                counts[0] += 1

    if (os.cpu_count() or 1) < 2:
        pytest.skip("one processor")
    thread = threading.Thread(target=count)
    thread.start()
    try:
        before = counts[0]
        time.sleep(1)
        alone = counts[0] - before
        before, start = counts[0], time.monotonic()
        tiepoint.reconstruct(drive, tmp_path / "ws", threads=1, progress=False)
        beside = (counts[0] - before) / (time.monotonic() - start)
    finally:
        stop.set()
        thread.join()
    assert beside > KEPT_SPEED * alone


def test_same_model_with_any_number_of_threads(drive, workspace, tmp_path):
    tiepoint.reconstruct(drive, tmp_path / "ws", rig="off", threads=1)
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        one, other = ((folder / "sparse/0" / name) for folder in (workspace, tmp_path / "ws"))
        assert one.read_bytes() == other.read_bytes()


def test_import_is_quick():
    code = "import time, numpy; t = time.time(); import tiepoint; print(time.time() - t)"
    seconds = min(
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)
        for _ in range(3)
    )
    assert seconds < 0.1
