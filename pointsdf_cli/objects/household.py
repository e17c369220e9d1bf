"""Other things about the house: lamps, shoes, locks, cups to go, buckets, tea pots."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import arc, polygon, rounded, smooth_curve, smooth_steps, soften
from pointsdf_cli.objects.solids import (
    bevelled,
    centred,
    cylinder,
    ellipsoid,
    loft,
    rounded_box,
    tube,
    turn,
    union,
)
from pointsdf_cli.objects.walls import cavity, shell, side_handle, solid_of


def lamp(draw: Draw) -> Manifold:
    """A table lamp: foot, stem (straight or a swan neck) and a hollow shade."""
    foot = draw.uniform("foot_radius", 0.035, 0.07)
    stem = draw.uniform("stem_radius", 0.003, 0.009)
    height = draw.uniform("height", 0.12, 0.24)
    shade = draw.uniform("shade_radius", 0.04, 0.075)
    drop = draw.uniform("shade_height", 0.04, 0.08)
    top_ratio = draw.uniform("shade_top", 0.35, 0.9)
    wall = draw.uniform("wall", 0.0015, 0.003)
    rise = draw.uniform("foot_height", 0.006, 0.02)
    base = turn([(foot, 0), (foot, 0.4 * rise), (2 * stem, rise)], fillet=0.001)
    line = soften([(0, drop), (top_ratio * shade, drop), (shade, 0)], 1)
    cover = shell(line, wall)
    if draw.chance("swan_neck", 0.5):
        reach = draw.uniform("reach", 0.03, 0.09)
        upright = [(0, 0, 0.5 * rise), (0, 0, 0.6 * height)]
        neck = [(0.45 * reach, 0, height), (reach, 0, 0.86 * height), (reach, 0, 0.78 * height)]
        path = smooth_curve([*upright, *neck], 26)
        cover = cover.translate((reach, 0, 0.78 * height - drop))
    else:
        path = np.linspace((0, 0, 0.5 * rise), (0, 0, height), 6)
        cover = cover.translate((0, 0, height - drop))
    return union([base, cover, tube(path, stem, up=(0, 1, 0), corners=14)])


def shoe(draw: Draw) -> Manifold:
    """A shoe or slipper: a sole under an upper that is open at the ankle."""
    length = draw.uniform("length", 0.11, 0.29)
    width = length * draw.uniform("width_ratio", 0.3, 0.4)
    height = length * draw.uniform("height_ratio", 0.26, 0.42)
    wall = draw.uniform("wall", 0.003, 0.005)
    t = np.linspace(0, 1, 24)
    at, widths = [0, 0.04, 0.15, 0.42, 0.7, 0.92, 1], [0.3, 0.55, 0.72, 0.66, 1.0, 0.62, 0.3]
    half = width / 2 * smooth_steps(at, widths, t)
    at, heights = [0, 0.06, 0.3, 0.45, 0.75, 0.95, 1], [0.8, 1.0, 1.0, 0.82, 0.42, 0.3, 0.2]
    top = height * smooth_steps(at, heights, t)

    def body(shrink: float, floor: float) -> Manifold:
        angle = np.linspace(0, 2 * np.pi, 28, endpoint=False)
        x = length * t[:, None] * np.ones(28)
        x = shrink + x * (1 - 2 * shrink / length)
        y = (half - shrink)[:, None] * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.7
        unit = 0.5 + 0.5 * np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** 0.7
        z = floor + (top - shrink - floor)[:, None] * unit
        return loft(np.stack([x, y, z], axis=-1))

    upper = body(0.0, 0.0)
    inside = body(wall, 2 * wall)
    mouth = length * draw.uniform("mouth", 0.3, 0.45)
    opening = rounded_box((mouth, 0.62 * width, height), 0.25 * width)
    opening = opening.translate((0.05 * length + mouth / 2, 0, 0.55 * height))
    if draw.chance("narrow_mouth", 0.3):
        opening = opening ^ inside.translate((0, 0, 0.3 * height))
    sole_rim = draw.uniform("sole_rim", 0.001, 0.005)
    side = np.column_stack([length * t, half + sole_rim])
    outline = np.concatenate([side, side[::-1] * [1, -1]])
    sole = bevelled(rounded(polygon(outline), 0.004), draw.uniform("sole", 0.008, 0.02), 0.002)
    hollow = inside + (opening - sole)
    shoe_body = union([upper, sole]) - hollow.trim_by_plane((0, 0, 1), 0.012)
    if draw.chance("heel", 0.4):
        heel = rounded_box((0.24 * length, 1.1 * half[4], 0.02), 0.003)
        shoe_body = union([shoe_body, heel.translate((0.14 * length, 0, -0.014))])
    return shoe_body


def padlock(draw: Draw) -> Manifold:
    """A padlock, handbag or kettle bell: a body under a thick bow."""
    width = draw.uniform("width", 0.03, 0.08)
    height = width * draw.uniform("height_ratio", 0.7, 1.2)
    depth = width * draw.uniform("depth_ratio", 0.25, 0.6)
    bow = width * draw.uniform("bow_radius", 0.06, 0.11)
    span = width * draw.uniform("span", 0.26, 0.38)
    rise = width * draw.uniform("rise", 0.1, 0.7)
    arch = arc(span, 0, np.pi, 16, (0, rise))
    x, z = np.array([(span, -0.2 * height), *arch, (-span, -0.2 * height)]).T
    path = np.column_stack([x, np.zeros_like(x), z + height])
    body = rounded_box((width, depth, height), 0.12 * depth)
    if draw.chance("round_body", 0.35):
        disc = centred(cylinder(width / 2, depth, 0.1 * depth, segments=44), depth, (90, 0, 0))
        body = disc.translate((0, 0, height - 0.42 * width))
    return union([body, tube(path, bow, up=(0, 1, 0), corners=14, round_ends=False)])


def cup_to_go(draw: Draw) -> Manifold:
    """A closed paper cup, yoghurt pot or thermos cup: tapered, under a lid wider than itself."""
    radius = draw.uniform("radius", 0.03, 0.05)
    height = radius * draw.uniform("height_ratio", 1.0, 3.6)
    foot = radius * draw.uniform("foot_ratio", 0.62, 0.95)
    lid = draw.uniform("lid_height", 0.002, 0.016)
    rim = radius + draw.uniform("rim", 0.001, 0.004)
    side = [(foot - 0.003, 0.004), (foot - 0.003, 0), (foot, 0), (radius, height)]
    edge = [(rim, height), (rim, height + 0.4 * lid)]
    top = [(0.88 * radius, height + lid), (0.8 * radius, height + 0.6 * lid)]
    cup = turn([*side, *edge, *top], fillet=0.0006)
    if draw.chance("straw", 0.25):
        lean = draw.uniform("lean", -0.2, 0.2)
        straw = cylinder(0.0035, 0.07, segments=14).rotate((0, float(np.degrees(lean)), 0))
        cup = union([cup, straw.translate((0.2 * radius, 0, height - 0.01))])
    return cup


def bucket(draw: Draw) -> Manifold:
    """A bucket or basket: a tapered open vessel under a bow handle."""
    radius = draw.uniform("radius", 0.035, 0.095)
    height = radius * draw.uniform("height_ratio", 0.9, 1.9)
    wall = draw.log_uniform("wall", 0.0015, 0.004)
    foot = radius * draw.uniform("foot_ratio", 0.65, 0.95)
    line = np.array([(0, 0), (foot, 0), (radius, height)])
    bow = draw.uniform("bow_radius", 0.002, 0.006)
    rise = radius * draw.uniform("rise", 0.6, 1.3)
    t = np.linspace(0, np.pi, 30)
    reach = radius + 0.5 * wall
    path = np.column_stack([reach * np.cos(t), np.zeros(30), 0.92 * height + rise * np.sin(t)])
    side = np.interp(0.82 * height, [0, height], [foot, radius])
    path = np.array([(side, 0, 0.82 * height), *path, (-side, 0, 0.82 * height)])
    handle = tube(path, bow, draw.uniform("bow_flatness", 1.0, 2.5) * bow, up=(0, 1, 0), corners=12)
    return union([shell(line, wall), handle - cavity(line, wall)])


def teapot(draw: Draw) -> Manifold:
    """A tea pot, kettle or watering can: a closed body with a spout and a handle."""
    radius = draw.uniform("radius", 0.045, 0.075)
    height = radius * draw.uniform("height_ratio", 1.0, 1.9)
    foot = radius * draw.uniform("foot_ratio", 0.5, 0.8)
    neck = radius * draw.uniform("neck_ratio", 0.35, 0.65)
    side = [(foot, 0), (radius, 0.25 * height), (radius, 0.65 * height), (neck, height)]
    line = soften([(0, 0), *side])
    body = solid_of(line, 0.002)
    dome = draw.uniform("lid_dome", 0.004, 0.02)
    lid = [(neck, -0.004), (neck, 0.002), (0.6 * neck, dome), (0, dome + 0.001)]
    top = turn(lid, fillet=0.001)
    knob = ellipsoid((0.009, 0.009, 0.009), segments=20)
    thick = draw.uniform("spout_radius", 0.006, 0.011)
    reach = radius * draw.uniform("spout_reach", 0.4, 0.8)
    start = 0.3 * height
    tip = height * draw.uniform("spout_height", 0.8, 1.1)
    bend = (-radius - 0.6 * reach, 0, start + 0.45 * (tip - start))
    path = smooth_curve([(-0.9 * radius, 0, start), bend, (-radius - reach, 0, tip)], 14)
    spout = tube(path, (1.5 * thick, thick), up=(0, 1, 0))
    grip = draw.uniform("handle_radius", 0.0045, 0.0075)
    cover = [top.translate((0, 0, height)), knob.translate((0, 0, height + dome + 0.006))]
    return union([body, spout, *cover, _pot_handle(draw, line, radius, height, grip)])


def _pot_handle(
    draw: Draw, line: np.ndarray, radius: float, height: float, grip: float
) -> Manifold:
    """A handle of thickness `grip` [m] above or beside a pot of this profile [N, 2]."""
    if draw.chance("handle_above", 0.3):
        t = np.linspace(0.1, np.pi - 0.1, 24)
        z = 0.75 * height + (0.25 * height + 0.95 * radius) * np.sin(t)
        path = np.column_stack([0.8 * radius * np.cos(t), np.zeros(24), z])
        return tube(path, grip, up=(0, 1, 0), corners=14)
    reach = draw.uniform("handle_reach", 0.022, 0.04) + grip
    squareness = draw.uniform("handle_squareness", 0, 1)
    return side_handle(line, 0.25 * height, 0.8 * height, reach, squareness, grip, grip, 0.95)


def controller(draw: Draw) -> Manifold:
    """A game controller or camera: a slab with two grips, knobs and a lens."""
    width = draw.uniform("width", 0.09, 0.16)
    depth = width * draw.uniform("depth_ratio", 0.35, 0.6)
    height = draw.uniform("height", 0.018, 0.04)
    parts = [rounded_box((width, depth, height), 0.42 * height)]
    if draw.chance("grips", 0.6):
        reach = draw.uniform("grip_reach", 0.3, 0.7) * depth
        grip = 0.5 * height * draw.uniform("grip_ratio", 0.9, 1.2)
        for side in (-1, 1):
            root = (side * (0.5 * width - grip), 0, 0.5 * height)
            path = np.linspace(root, (side * (0.5 * width), -0.4 * depth - reach, 0.5 * height), 8)
            parts.append(tube(path, (grip, 0.8 * grip), (0.95 * grip, 0.75 * grip), corners=20))
    for index in range(draw.integer("knobs", 1, 4)):
        size = float(draw.rng.uniform(0.004, 0.012))
        x, y = map(float, draw.rng.uniform(-0.38, 0.38, 2) * [width, depth])
        knob = cylinder(size, 0.004 + size, 0.001, segments=22)
        parts.append(knob.translate((x, y, height - 0.002 - 1e-4 * index)))
    if draw.chance("lens", 0.35):
        reach = draw.uniform("lens_length", 0.01, 0.05) + height
        parts.append(cylinder(0.45 * min(depth, width), reach, 0.002, segments=40))
    return union(parts)


FAMILIES = (
    Family("lamp", lamp, 1.5, "compound", 0.002),
    Family("shoe", shoe, 1.5, "vessel", 0.004, 0),
    Family("padlock", padlock, 1.0, "compound", 0.003, 1),
    Family("cup_to_go", cup_to_go, 1.5, "round", 0.004, 0),
    Family("bucket", bucket, 1.0, "vessel", 0.002, 1),
    Family("teapot", teapot, 1.0, "compound", 0.003, 1),
    Family("controller", controller, 1.0, "compound", 0.004, 0),
)
