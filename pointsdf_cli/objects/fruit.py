"""Balls, fruit and vegetables."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pointsdf_cli.geometry.frames import random_rotation
from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import smooth_curve, smooth_steps
from pointsdf_cli.objects.solids import cylinder, ellipsoid, star_solid, tube, union


def ball(draw: Draw) -> Manifold:
    """A ball: smooth, a tennis seam, panels, dimples, or pointed as in rugby."""
    radius = draw.log_uniform("radius", 0.017, 0.11)
    form = draw.choice("form", ("smooth", "smooth", "seam", "panels", "dimples", "pointed"))
    depth = draw.uniform("groove", 0.004, 0.02) * radius
    turn = random_rotation(draw.rng, 1)[0]
    if form == "pointed":
        stretch = draw.uniform("stretch", 1.3, 1.8)
        radius = min(radius, 0.09)
        sharp = draw.uniform("sharpness", 0.6, 1.0)

        def lens(points: np.ndarray) -> np.ndarray:
            along = points[:, 0]
            girth = (1 - along**2) ** sharp / np.maximum(np.sqrt(1 - along**2), 1e-6)
            return points * np.column_stack([np.full_like(along, stretch), girth, girth]) * radius

        return Manifold.sphere(1.0, 72).warp_batch(lens)
    axes = _fibonacci_sphere(draw.integer("features", 12, 60))

    def surface(direction: np.ndarray) -> np.ndarray:
        d = direction @ turn.T
        if form == "seam":
            # The saddle curve of a tennis ball: z against a quartic of the two other axes.
            height = d[:, 2] - 0.9 * (d[:, 0] ** 2 - d[:, 1] ** 2)
            return radius - depth * np.exp(-((height / 0.09) ** 2))
        if form == "panels":
            nearest = np.sort(d @ axes.T, axis=1)[:, -2:]
            return radius - depth * np.exp(-((np.diff(nearest, axis=1)[:, 0] / 0.05) ** 2))
        if form == "dimples":
            angle = np.arccos(np.clip((d @ axes.T).max(axis=1), -1, 1))
            return radius - depth * np.exp(-((angle / (1.1 / np.sqrt(len(axes)))) ** 2))
        return np.full(len(d), radius)

    return star_solid(surface, segments=96 if form in ("panels", "seam", "dimples") else 72)


def apple(draw: Draw) -> Manifold:
    """An apple, tomato, pumpkin or bell pepper: dimpled at the poles, ribbed, with a stem."""
    radius = draw.uniform("radius", 0.025, 0.06)
    flatness = draw.uniform("flatness", 0.7, 1.1)
    top, bottom = draw.uniform("top_dimple", 0.1, 0.4), draw.uniform("bottom_dimple", 0.0, 0.25)
    ribs, depth = draw.integer("ribs", 3, 10), draw.uniform("rib_depth", 0.0, 0.06)
    lean = draw.uniform("shoulder", -0.15, 0.2)

    def surface(d: np.ndarray) -> np.ndarray:
        z, around = d[:, 2], np.arctan2(d[:, 1], d[:, 0])
        dimples = top * np.exp(-((1 - z) / 0.09)) + bottom * np.exp(-((1 + z) / 0.08))
        return radius * (1 + lean * z - dimples - depth * (1 - z**2) * np.cos(ribs * around))

    fruit = star_solid(surface, segments=72).scale((1, 1, flatness))
    if not draw.chance("stem", 0.6):
        return fruit
    reach = radius * flatness * (1 + lean)
    bend = draw.uniform("stem_bend", -0.3, 0.3) * radius
    thick = draw.uniform("stem_radius", 0.0015, 0.003)
    root = (0, 0, (1 - top) * reach - 0.15 * radius)
    path = smooth_curve([root, (0, 0, 0.98 * reach), (bend, 0, 1.2 * reach)], 8)
    return union([fruit, tube(path, thick, up=(0, 1, 0), corners=8)])


def pear(draw: Draw) -> Manifold:
    """A pear, avocado, egg or fig lying on its side: two bellies of unlike size."""
    radius = draw.uniform("radius", 0.022, 0.045)
    length = radius * draw.uniform("length_ratio", 2.3, 3.4)
    neck = draw.uniform("neck_ratio", 0.35, 0.85)
    at = np.array([0, 0.04, 0.12, 0.32, 0.55, 0.78, 0.93, 1.0])
    shape = np.array([0.0, 0.42, 0.72, 1.0, 0.5 + 0.45 * neck, neck, 0.62 * neck, 0.0])
    # Cosine spacing: the poles, where the radius grows like a square root, need more rings.
    t = (1 - np.cos(np.linspace(0, np.pi, 40)))[1:-1] / 2
    squared = smooth_steps(at, (radius * shape) ** 2, t)
    path = np.column_stack([length * t, np.zeros((38, 2))])
    body = tube(path, np.sqrt(squared), corners=32, round_ends=False)
    if draw.chance("stem", 0.6):
        knots = [(0.97 * length, 0, 0), (1.06 * length, 0, 0.002), (1.16 * length, 0, 0.006)]
        path = smooth_curve(knots, 8)
        body = union([body, tube(path, draw.uniform("stem_radius", 0.0015, 0.0028), corners=8)])
    return body


def lemon(draw: Draw) -> Manifold:
    """A lemon or lime lying on its side: an ellipsoid with a nipple at either end."""
    radius = draw.uniform("radius", 0.021, 0.036)
    length = 2 * radius * draw.uniform("length_ratio", 1.05, 1.5)
    left, right = draw.uniform("left_nipple", 0.0, 0.1), draw.uniform("right_nipple", 0.03, 0.16)
    width = draw.uniform("nipple_width", 0.2, 0.35)

    def surface(d: np.ndarray) -> np.ndarray:
        x = d[:, 0]
        ends = right * np.exp(-((1 - x) / (width**2))) + left * np.exp(-((1 + x) / (width**2)))
        return radius * (1 + 1.5 * ends)

    return star_solid(surface, segments=64).scale((length / (2 * radius), 1, 1))


def strawberry(draw: Draw) -> Manifold:
    """A strawberry: a blunt cone covered in small pits, perhaps with leaves."""
    radius = draw.uniform("radius", 0.017, 0.026)
    taper = draw.uniform("taper", 0.15, 0.45)
    stretch = draw.uniform("stretch", 1.0, 1.4)
    pits = _fibonacci_sphere(draw.integer("pits", 50, 110))
    depth = draw.uniform("pit_depth", 0.0, 0.035)

    def surface(d: np.ndarray) -> np.ndarray:
        angle = np.arccos(np.clip((d @ pits.T).max(axis=1), -1, 1))
        hollow = depth * np.exp(-((angle / 0.09) ** 2))
        return radius * (1 + taper * d[:, 2] - 0.3 * np.exp(-(1 - d[:, 2]) / 0.12) - hollow)

    fruit = star_solid(surface, segments=80).scale((1, 1, stretch))
    lying = draw.chance("lies", 0.6)
    return fruit.rotate((0, 100, 0)) if lying else fruit


def plum(draw: Draw) -> Manifold:
    """A plum, peach or apricot: round with one crease from pole to pole."""
    radius = draw.uniform("radius", 0.018, 0.042)
    crease = draw.uniform("crease", 0.02, 0.1)
    width = draw.uniform("crease_width", 0.1, 0.3)
    stretch = draw.uniform("stretch", 0.85, 1.2)
    dimple = draw.uniform("dimple", 0.0, 0.25)

    def surface(d: np.ndarray) -> np.ndarray:
        around = np.arctan2(d[:, 1], d[:, 0])
        fold = crease * np.exp(-((around / width) ** 2)) * np.sqrt(1 - np.minimum(d[:, 2] ** 2, 1))
        return radius * (1 - fold - dimple * np.exp(-(1 - d[:, 2]) / 0.06))

    return star_solid(surface, segments=72).scale((1, 1, stretch))


def potato(draw: Draw) -> Manifold:
    """A lump: potato, ginger, stone, bread roll; an ellipsoid with smooth random bumps."""
    radius = draw.uniform("radius", 0.02, 0.05)
    stretch, flatness = draw.uniform("stretch", 1.0, 2.2), draw.uniform("flatness", 0.6, 1.0)
    bumps = draw.integer("bumps", 3, 14)
    height = draw.uniform("bump_height", 0.03, 0.25)
    axes = draw.rng.normal(size=(bumps, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    sign = draw.rng.uniform(-0.6, 1.0, bumps)

    def surface(d: np.ndarray) -> np.ndarray:
        return radius * (1 + height * (np.exp(-(1 - d @ axes.T) / 0.15) @ sign).clip(-0.9, 2.0))

    return star_solid(surface, segments=64).scale((stretch, 1, flatness))


def banana(draw: Draw) -> Manifold:
    """A banana lying on its side: bent, five-edged, thinning to a stalk and a blunt tip."""
    length = draw.uniform("length", 0.14, 0.24)
    radius = draw.uniform("radius", 0.014, 0.021)
    sweep = draw.uniform("bend", 0.7, 1.9)
    stalk = draw.uniform("stalk_ratio", 0.25, 0.4)
    t = np.linspace(0, 1, 30)
    angle = sweep * (t - 0.5)
    bow = length / sweep
    path = np.column_stack([bow * np.sin(angle), bow * np.cos(angle), np.zeros_like(t)])
    widths = [0.35, 0.6, 0.9, 1, 0.8, stalk, stalk]
    swell = smooth_steps([0, 0.06, 0.2, 0.5, 0.8, 0.9, 1], widths, t)
    return tube(path, radius * swell, radius * swell * draw.uniform("girth", 0.88, 1.0), corners=12)


def cucumber(draw: Draw) -> Manifold:
    """A long fruit lying down: cucumber, courgette, carrot, squash; tapered, bent and ribbed."""
    length = draw.uniform("length", 0.12, 0.32)
    radius = length * draw.uniform("slenderness", 0.07, 0.17)
    blossom, stem = draw.uniform("blossom_end", 0.4, 1.3), draw.uniform("stem_end", 0.15, 1.0)
    sweep = draw.uniform("bend", 0.01, 0.8)
    t = np.linspace(0, 1, 30)
    angle = sweep * (t - 0.5)
    bow = length / sweep
    path = np.column_stack([bow * np.sin(angle), bow * (np.cos(angle) - 1), np.zeros_like(t)])
    at = [0, 0.04, 0.12, 0.3, 0.6, 0.9, 0.97, 1]
    blossom_end = [0.3 * blossom, 0.7 * blossom, 0.95 * blossom]
    stem_end = [(1 + stem) / 2, stem, 0.7 * stem, 0.3 * stem]
    swell = smooth_steps(at, [*blossom_end, 1, *stem_end], t)
    return tube(path, radius * swell, corners=20)


def mushroom(draw: Draw) -> Manifold:
    """A stalk under a cap: mushrooms, door knobs, light bulbs, spinning tops."""
    cap = draw.uniform("cap_radius", 0.018, 0.06)
    rise = cap * draw.uniform("rise", 0.4, 1.0)
    stalk = cap * draw.uniform("stalk_ratio", 0.25, 0.6)
    length = cap * draw.uniform("stalk_length", 0.6, 2.0)
    dome = ellipsoid((cap, cap, rise), segments=44).trim_by_plane((0, 0, 1), -0.3 * rise)
    return union([cylinder(stalk, length, 0.2 * stalk), dome.translate((0, 0, length))])


def _fibonacci_sphere(count: int) -> np.ndarray:
    """Evenly spread directions [count, 3]."""
    step = np.arange(count) + 0.5
    z = 1 - 2 * step / count
    around = np.pi * (1 + 5**0.5) * step
    radius = np.sqrt(1 - z**2)
    return np.column_stack([radius * np.cos(around), radius * np.sin(around), z])


FAMILIES = (
    Family("ball", ball, 5.0, "round", 0.004, 0),
    Family("apple", apple, 2.5, "round", 0.015, 0),
    Family("pear", pear, 2.0, "round", 0.015, 0),
    Family("lemon", lemon, 1.5, "round", 0.012, 0),
    Family("strawberry", strawberry, 1.5, "round", 0.015, 0),
    Family("plum", plum, 2.0, "round", 0.012, 0),
    Family("potato", potato, 2.0, "round", 0.02, 0),
    Family("banana", banana, 2.0, "round", 0.01, 0),
    Family("cucumber", cucumber, 2.0, "round", 0.012, 0),
    Family("mushroom", mushroom, 1.0, "round", 0.01, 0),
)
