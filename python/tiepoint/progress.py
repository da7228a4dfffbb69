"""Progress of a command: a bar in terminals and notebooks."""

import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, Optional, TextIO, Union

WIDTH = 30
# Seconds between two drawings.
INTERVAL = 0.1
# What an event is called that ends a step of its stage.
STEPS = {"image_done", "image_skipped", "pair_done", "dense_done"}
# Events that are told in a line of their own, and their texts.
LINES = {
    "image_skipped": "skipped {why}",
    "noted": "{what}",
    "pairs_chosen": "matching {pairs} pairs ({selection})",
    "colors_missing": "the points have no colours: {why}",
    "camera_calibrated": "the camera of {image} is calibrated by {calibration}",
}


def is_shown() -> bool:
    """Whether there is a terminal or a notebook."""
    if "ipykernel" in sys.modules:
        return True
    return sys.stderr is not None and sys.stderr.isatty()


@contextlib.contextmanager
def default_progress(
    progress: Union[None, bool, Callable[[dict[str, Any]], object]],
) -> Iterator[Optional[Callable[[str], object]]]:
    """The function that gets the events as JSON, or None."""
    if callable(progress):
        yield lambda event: progress(json.loads(event))
    elif progress is True or progress is None and is_shown():
        bar = Bar(sys.stderr)
        try:
            yield bar.event
        finally:
            bar.close()
    else:
        yield None


class Bar:
    """A line that is drawn again and again: stage, bar, steps and time."""

    def __init__(self, file: TextIO) -> None:
        self.file, self.total, self.done = file, 0, 0
        self.stage: Optional[str] = None
        self.start = self.drawn_at = time.monotonic()
        self.length = 0

    def event(self, text: str) -> None:
        event = json.loads(text)
        kind = event["event"]
        if kind in LINES:
            self.clear()
            self.file.write(LINES[kind].format(**event) + "\n")
        if kind == "stage_began":
            self.stage, self.total, self.done = event["stage"], event["total"], event["done"]
            self.start = time.monotonic()
            self.draw()
        elif kind in STEPS:
            self.done += 1
        elif kind in ("image_registered", "rendering", "nodes"):
            self.done = event.get("registered", event.get("done"))
            self.total = event.get("total", self.total)
            self.stage = self.stage or "render"
        elif kind == "stage_done":
            self.draw()
            self.file.write("\n")
            self.length, self.stage = 0, None
        if self.stage and time.monotonic() - self.drawn_at >= INTERVAL:
            self.draw()

    def draw(self) -> None:
        share = min(self.done / self.total, 1) if self.total else 0
        full = round(share * WIDTH)
        bar = "█" * full + "░" * (WIDTH - full)
        seconds = time.monotonic() - self.start
        line = f"{self.stage or '':>8} {bar} {self.done}/{self.total} {seconds:.0f} s"
        self.clear()
        self.file.write(line)
        self.file.flush()
        self.length, self.drawn_at = len(line), time.monotonic()

    def clear(self) -> None:
        self.file.write("\r" + " " * self.length + "\r")
        self.length = 0

    def close(self) -> None:
        if self.length:
            self.file.write("\n")
            self.file.flush()
