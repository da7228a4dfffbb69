"""Measures how fast report.html draws a model of many points in headless Chromium.

    pip install numpy
    python bench/view.py [--points 2000000] [--size 1200x800] [--program TIEPOINT]

Prints JSON: the size of the page, the time until it has drawn all points, the time of a frame with
all points (drawn and read back, so that nothing is left to do) with the processor time that it
took, and, while the view turns, the time between frames and the points drawn in them. WebGL is done
in software (SwiftShader) unless --angle names another backend, so that times say what a machine
without a graphics card does. Let nothing else run.
"""

import argparse
import http.server
import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from program import program_of

IMAGES = 20
PATIENCE_S = 600
# Runs in the page, with its own functions.
SCRIPT = """
addEventListener('load', async () => {
  const frame = () => new Promise(requestAnimationFrame);
  const [section] = sections, [view] = section.views;
  const gl = renderer.getContext();
  const sync = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  const median = values => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
  while (view.drawn < view.points.count) await frame();
  sync();
  const found = { load_ms: performance.now(), points: view.points.count };
  found.size = [view.canvas.width, view.canvas.height];
  const turn = () => {
    section.yaw += 0.05;
    reset(section);
  };
  const mark = name => fetch(`/mark/${name}`, { method: 'POST', body: '{}' });
  const times = [];
  await mark('start');
  for (let k = 0; k < 12; k++) {
    turn();
    const start = performance.now();
    draw(view, false);
    sync();
    times.push(performance.now() - start);
    await frame();
  }
  await mark('end');
  found.frames = times.length;
  found.frame_ms = median(times);
  found.fastest_frame_ms = Math.min(...times);
  const [intervals, drawn] = [[], []];
  let last = await frame();
  for (let k = 0; k < 60; k++) {
    turn();
    redraw(section, true);
    const now = await frame();
    intervals.push(now - last);
    drawn.push(view.drawn);
    last = now;
  }
  // The first frames find out how many points are fast enough.
  found.moving_frame_ms = median(intervals.slice(25));
  found.moving_points = median(drawn.slice(25));
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  found.renderer = info && gl.getParameter(info.UNMASKED_RENDERER_WEBGL);
  await fetch('/result', { method: 'POST', body: JSON.stringify(found) });
});
"""


def write_model(folder, count):
    """A COLMAP model: a wavy ring of points, and images inside of it that look outwards."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, count)
    height = rng.uniform(-1, 1, count)
    radius = 5 + 0.4 * np.sin(8 * angle) + rng.normal(0, 0.02, count)
    xyz = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], 1)
    first = np.floor(angle / (2 * np.pi) * IMAGES).astype(np.uint32) % IMAGES
    seen = np.stack([first, (first + 1) % IMAGES], 1)
    track = np.dtype([("image", "<u4"), ("keypoint", "<u4")])
    record = np.dtype(
        [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")]
        + [("track", track, 2)]
    )
    points = np.zeros(count, record)
    points["id"] = np.arange(1, count + 1)
    points["xyz"] = xyz
    points["rgb"] = np.clip(128 + 25 * xyz, 0, 255)
    points["length"] = 2
    points["track"]["image"] = seen + 1
    keypoint = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
    images = []
    for image in range(IMAGES):
        of_image = []
        for place in range(2):
            index = np.flatnonzero(seen[:, place] == image)
            points["track"]["keypoint"][index, place] = sum(map(len, of_image)) + np.arange(
                len(index)
            )
            of_image.append(index)
        index = np.concatenate(of_image)
        keypoints = np.zeros(len(index), keypoint)
        keypoints["xy"] = rng.uniform(0, [640, 480], (len(index), 2))
        keypoints["point"] = index + 1
        # Looks along (cos, 0, sin) from a circle of radius 2; y is down.
        turn = 2 * np.pi * (image + 1) / IMAGES
        half = (turn - np.pi / 2) / 2
        quaternion, translation = [np.cos(half), 0, np.sin(half), 0], [0, 0, -2]
        images.append((quaternion, translation, image, keypoints))
    count_of = lambda values: np.uint64(len(values)).tobytes()
    (folder / "points3D.bin").write_bytes(count_of(points) + points.tobytes())
    with open(folder / "images.bin", "wb") as file:
        file.write(count_of(images))
        for quaternion, translation, image, keypoints in images:
            file.write(np.uint32(image + 1).tobytes())
            file.write(np.array(quaternion + translation, "<f8").tobytes())
            file.write(np.uint32(1).tobytes() + f"{image:02}.jpg".encode() + b"\0")
            file.write(count_of(keypoints) + keypoints.tobytes())
    camera = np.array([1, 0], "<u4").tobytes() + np.array([640, 480], "<u8").tobytes()
    camera += np.array([500, 320, 240], "<f8").tobytes()
    (folder / "cameras.bin").write_bytes(np.uint64(1).tobytes() + camera)


def serve(page):
    """Serves the page; the server's `result` is what its script sends."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200 if self.path == "/" else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            if self.path == "/":
                self.wfile.write(page)

        def do_POST(self):
            length = int(self.headers["Content-Length"])
            found = json.loads(self.rfile.read(length))
            if self.path.startswith("/mark/"):
                self.server.marks[self.path.removeprefix("/mark/")] = self.server.clock()
            else:
                self.server.result = found
                self.server.done.set()
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("localhost", 0), Handler)
    server.done, server.result, server.marks = threading.Event(), None, {}
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def processor_s(ancestor):
    """Processor time of a process and all that it started."""
    times, children = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = path.read_text()
        except OSError:
            continue
        # After the name, which may hold anything: state, parent, ..., times as user and system.
        words = text.rpartition(")")[2].split()
        process = int(path.parent.name)
        times[process] = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
        children.setdefault(int(words[1]), []).append(process)
    total, todo = 0, [ancestor]
    while todo:
        process = todo.pop()
        total += times.get(process, 0)
        todo += children.get(process, [])
    return total


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=2_000_000)
    parser.add_argument("--size", default="1200x800", help="of the window")
    parser.add_argument("--browser", default="chromium")
    parser.add_argument("--angle", default="swiftshader", help="backend of WebGL")
    parser.add_argument("--program", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write_model(folder, arguments.points)
        command = [program_of(arguments), "view", folder]
        subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)
        html = (folder / "report.html").read_text()
        # The page may load nothing; this copy may send its result.
        policy = "default-src 'none';"
        assert policy in html
        copy = html.replace(policy, policy + " connect-src 'self';", 1)
        server = serve((copy + f"<script>{SCRIPT}</script>").encode())
        command = [arguments.browser, "--headless", "--no-sandbox", "--no-first-run"]
        command += [f"--use-angle={arguments.angle}", "--enable-unsafe-swiftshader"]
        command += ["--disable-background-networking", "--disable-component-update"]
        command += ["--disable-sync", f"--window-size={arguments.size.replace('x', ',')}"]
        command += [f"--user-data-dir={folder / 'profile'}"]
        command += [f"http://localhost:{server.server_port}/"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        browser = subprocess.Popen(command, **quiet, start_new_session=True)
        server.clock = lambda: processor_s(browser.pid)
        done = server.done.wait(PATIENCE_S)
        browser.terminate()
        browser.wait()
        server.shutdown()
        if not done:
            sys.exit(f"{arguments.browser} gave no result within {PATIENCE_S} s")
        result = {"cores": len(os.sched_getaffinity(0)), "page_mb": len(html.encode()) / 1e6}
        result |= server.result
        spent_s = server.marks["end"] - server.marks["start"]
        result["frame_processor_ms"] = 1e3 * spent_s / result["frames"]
        result["load_average"] = os.getloadavg()[0]
        print(json.dumps(result, indent=1))


main()
