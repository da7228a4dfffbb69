"""A made scene without planes, rendered with exact depths: a round room, blobs in it, and leaves in
front of them.

All surfaces are ellipsoids, so that the first hit of a ray is the root of a quadratic. Their
texture is noise in space, from which octaves finer than two pixels are left out. Four rays a pixel
make the picture; the depth is that of the ray through the centre of the pixel."""

import numpy as np

OCTAVES = 7
COARSEST_PER_M = 1.0
SUBSAMPLES = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]


def rotation(rng):
    """A uniform random rotation (Shoemake 1992)."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def ellipsoids(seed, leaves=250):
    """Centres (m), radii (m) and rotations: the room, the blobs, the leaves."""
    rng = np.random.default_rng(seed)
    found = [(np.zeros(3), np.array([6.0, 3.5, 6.0]), np.eye(3))]
    for index in range(9):
        angle = 2 * np.pi * index / 9 + rng.uniform(-0.2, 0.2)
        centre = np.array([2.2 * np.sin(angle), rng.uniform(-1.2, 1.6), 3.0 + np.cos(angle)])
        found.append((centre, rng.uniform(0.35, 0.9, 3), rotation(rng)))
    for _ in range(leaves):
        offset = rng.normal(size=3) * [0.9, 0.7, 0.5]
        centre = np.array([-0.4, 0.3, 1.6]) + offset
        found.append((centre, np.array([0.12, 0.08, 0.015]), rotation(rng)))
    return found


def noise(points, seed):
    """Value noise at points in space: random values on a grid, interpolated smoothly."""
    cell = np.floor(points)
    t = points - cell
    t = t * t * (3 - 2 * t)
    cell = cell.astype(np.int64)
    total = np.zeros(len(points))
    for corner in range(8):
        bits = np.array([corner >> axis & 1 for axis in range(3)])
        weight = np.prod(np.where(bits, t, 1 - t), axis=1)
        at = (cell + bits).astype(np.uint64)
        with np.errstate(over="ignore"):
            h = at[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ at[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
            h ^= at[:, 2] * np.uint64(0x165667B19E3779F9) ^ np.uint64(seed * 7919 + 1)
            for _ in range(2):
                h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        total += weight * ((h >> np.uint64(11)).astype(float) / 2.0**53)
    return total


def hits(centre, rays, pixels, camera, shapes):
    """Along rays, not of unit length, the nearest hit and its shape. `camera` is (R, f, c, size) to
    find the pixels of a shape; the room contains the camera."""
    turn, focal, middle, (width, height) = camera
    depth = np.full(len(rays), np.inf)
    shape = np.zeros(len(rays), int)
    for index, (place, radii, axes) in enumerate(shapes):
        if index == 0:
            chosen = slice(None)
        else:
            reach = radii.max()
            x, y, z = turn @ (place - centre)
            if z + reach <= 0.1:
                continue
            near = max(z - reach, 0.1)
            spread = focal * reach / near * 1.5 + 2
            u, v = focal * x / max(z, 0.1) + middle[0], focal * y / max(z, 0.1) + middle[1]
            chosen = np.nonzero((abs(pixels[:, 0] - u) < spread) & (abs(pixels[:, 1] - v) < spread))
            chosen = chosen[0]
            if len(chosen) == 0:
                continue
        o = axes.T @ (centre - place) / radii
        d = rays[chosen] @ axes / radii
        a, b, c = (d * d).sum(1), d @ o, o @ o - 1
        root = b * b - a * c
        with np.errstate(invalid="ignore"):
            step = np.sqrt(root)
            t = (-b + step) / a if index == 0 else (-b - step) / a
        is_hit = (root > 0) & (t > 0.05) & (t < depth[chosen])
        if index == 0:
            depth, shape = np.where(is_hit, t, np.inf), np.zeros(len(rays), int)
        else:
            depth[chosen[is_hit]], shape[chosen[is_hit]] = t[is_hit], index
    return depth, shape


def pose(index, count):
    """R and t of a camera on an arc, looking into the room."""
    angle = np.radians(-24 + 48 * index / max(count - 1, 1))
    centre = np.array([3.4 * np.sin(angle), 0.15 * np.cos(3 * angle), 2.2 - 4.4 * np.cos(angle)])
    ahead = np.array([-0.1, 0.25, 2.6]) - centre
    ahead /= np.linalg.norm(ahead)
    right = np.cross([0, 1, 0], ahead)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(ahead, right), ahead])
    return turn, -turn @ centre


def render(turn, shift, focal, size, shapes, seed, rng):
    """A picture (height × width × 3 bytes) and its depths."""
    width, height = size
    middle = (width / 2, height / 2)
    centre = -turn.T @ shift
    camera = (turn, focal, middle, size)
    rows, columns = np.mgrid[0:height, 0:width]

    def cast(du, dv):
        pixels = np.stack([columns.ravel() + du, rows.ravel() + dv], axis=1)
        flat = (pixels - middle) / focal
        rays = np.column_stack([flat, np.ones(len(flat))]) @ turn
        return rays, *hits(centre, rays, pixels, camera, shapes)

    light = np.zeros((height * width, 3))
    for du, dv in SUBSAMPLES:
        rays, depth, shape = cast(du, dv)
        points = centre + rays * depth[:, None]
        grain = np.zeros(len(points))
        for octave in range(OCTAVES):
            per_m = COARSEST_PER_M * 2**octave
            weight = np.clip(focal / (2 * depth * per_m) - 0.5, 0, 1) * 0.75**octave
            grain += weight * (noise(points * per_m + 7.3 * shape[:, None], seed + octave) - 0.5)
        tint = 0.75 + 0.25 * np.cos(shape[:, None] * 2.4 + np.array([0, 2.1, 4.2]))
        light += tint * (0.5 + 0.45 * grain[:, None]) / len(SUBSAMPLES)
    picture = 255 * np.clip(light, 0, 1) + rng.normal(0, 1.5, light.shape)
    _, depth, _ = cast(0.5, 0.5)
    picture = np.clip(np.round(picture), 0, 255).astype(np.uint8)
    return picture.reshape(height, width, 3), depth.reshape(height, width).astype(np.float32)


def write(folder, seed, count, size):
    """Photos as PNG; returns K's focal length and, by name, R, t and depths."""
    import pycolmap

    shapes, rng = ellipsoids(seed), np.random.default_rng(seed + 1)
    focal = 0.9 * size[0]
    folder.mkdir(parents=True)
    views = {}
    for index in range(count):
        turn, shift = pose(index, count)
        picture, depth = render(turn, shift, focal, size, shapes, seed, rng)
        name = f"{index:03}.png"
        pycolmap.Bitmap.from_array(picture).write(folder / name)
        views[name] = (turn, shift, depth)
    return focal, views
