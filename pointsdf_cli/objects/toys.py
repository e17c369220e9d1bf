"""Toys: aeroplanes, cars, animals, houses, skittles."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import (
    polygon,
    rounded,
    smooth_curve,
    smooth_steps,
    stroke,
    symmetric,
)
from pointsdf_cli.objects.solids import (
    bevelled,
    centred,
    cylinder,
    ellipsoid,
    loft_sections,
    rounded_box,
    tube,
    turn,
    union,
)


def aeroplane(draw: Draw) -> Manifold:
    """A toy aeroplane: fuselage, one or two wings, tail, propeller, wheels."""
    length = draw.uniform("length", 0.12, 0.27)
    body = length * draw.uniform("body_ratio", 0.07, 0.13)
    t = np.linspace(0, 1, 22)
    girth = [0.75, 0.9, 1.0, 0.95, draw.uniform("tail_ratio", 0.25, 0.6)]
    shape = body * smooth_steps([0, 0.04, 0.2, 0.45, 1], girth, t)
    path = np.column_stack([length * t, np.zeros_like(t), np.linspace(0, 0.25 * body, 22)])
    section = draw.uniform("section", 2.0, 3.5)
    parts = [tube(path, shape, 1.05 * shape, exponent=section, corners=20)]
    span = length * draw.uniform("span_ratio", 0.75, 1.2)
    chord = length * draw.uniform("chord_ratio", 0.16, 0.26)
    sheet = draw.uniform("wing_thickness", 0.004, 0.01)
    sweep, taper = draw.uniform("sweep", -0.05, 0.5) * chord, draw.uniform("wing_taper", 0.55, 1.0)
    wing_at = length * draw.uniform("wing_at", 0.2, 0.38)
    level = body * draw.uniform("wing_level", -0.7, 0.5)
    main = _wing(span / 2, chord, taper, sweep, sheet)
    parts.append(main.translate((wing_at, 0, level)))
    if draw.chance("biplane", 0.4):
        upper = level + body * draw.uniform("wing_gap", 1.5, 2.4)
        parts.append(main.translate((wing_at, 0, upper)))
        strut = cylinder(max(0.1 * body, 0.002), upper - level + 0.5 * sheet, segments=12)
        for y in (-0.3 * span, 0.3 * span, -0.5 * body, 0.5 * body):
            x = wing_at + 0.45 * chord + 0.6 * sweep * abs(y) / span
            parts.append(strut.translate((x, y, level + 0.25 * sheet)))
    tail = _wing(0.19 * span, 0.6 * chord, taper, 0.5 * sweep, 0.8 * sheet)
    parts.append(tail.translate((length - 0.6 * chord, 0, 0.2 * body)))
    fin = [(0, 0), (0.55 * chord, 0), (0.6 * chord, 1.9 * body), (0.25 * chord, 1.9 * body)]
    blade = bevelled(rounded(polygon(fin), 0.002), 0.8 * sheet, 0.2 * sheet)
    blade = centred(blade, 0.8 * sheet, (90, 0, 0))
    parts.append(blade.translate((length - 0.56 * chord, 0, 0.1 * body)))
    if draw.chance("propeller", 0.6):
        parts.append(_propeller(draw, body))
    if draw.chance("wheels", 0.6):
        parts += _landing_gear(draw, body, wing_at + 0.1 * chord)
    return union(parts)


def _wing(half_span: float, root: float, taper: float, back: float, thick: float) -> Manifold:
    """Both halves of a wing: chord `root`, tip `taper` · root and `back` [m] behind it."""
    tip = taper * root
    inner = -half_span * 0.02
    outline = [(0, inner), (root, inner), (back + tip, half_span), (back, half_span)]
    half = rounded(polygon(outline), 0.12 * root)
    return bevelled(half + half.mirror((0.0, 1.0)), thick, 0.3 * thick)


def _propeller(draw: Draw, body: float) -> Manifold:
    """A hub and two vanes before a fuselage of radius `body` [m]."""
    hub = tube(np.linspace((-0.9 * body, 0, 0), (0.1 * body, 0, 0), 5), 0.28 * body, corners=14)
    radii = (0.1 * body + 0.001, 0.28 * body, 1.5 * body)
    vane = ellipsoid(radii, (-0.6 * body, 0, 0), segments=20)
    return union([hub, vane.rotate((float(draw.uniform("propeller_turn", 0, 180)), 0, 0))])


def _landing_gear(draw: Draw, body: float, axle_x: float) -> list[Manifold]:
    """A leg, an axle at `axle_x` [m] and two wheels below a fuselage of radius `body` [m]."""
    wheel = draw.uniform("wheel", 0.4, 0.7) * body
    axle_z = -body - 0.8 * wheel
    axle = centred(cylinder(0.15 * wheel + 0.001, 2.2 * body, segments=12), 2.2 * body, (90, 0, 0))
    disc = centred(cylinder(wheel, 0.5 * wheel, 0.1 * wheel, segments=28), 0.5 * wheel, (90, 0, 0))
    leg = cylinder(0.18 * body, body + 0.8 * wheel, segments=12).translate((axle_x, 0, axle_z))
    discs = [disc.translate((axle_x, side * 0.95 * body, axle_z)) for side in (-1, 1)]
    return [leg, axle.translate((axle_x, 0, axle_z)), *discs]


def toy_car(draw: Draw) -> Manifold:
    """A toy car, lorry, bus or wagon on four wheels."""
    length = draw.uniform("length", 0.06, 0.18)
    width = length * draw.uniform("width_ratio", 0.36, 0.55)
    body = length * draw.uniform("body_ratio", 0.14, 0.26)
    cabin = length * draw.uniform("cabin_ratio", 0.1, 0.24)
    start, end = draw.uniform("cabin_start", -0.45, -0.1), draw.uniform("cabin_end", 0.05, 0.45)
    rake = draw.uniform("rake", 0.0, 0.6) * cabin
    half = length / 2
    front, rear = end * length, start * length
    roof = [(front, body + cabin), (rear, body + cabin)]
    windows = [(min(front + rake, half), body), *roof, (max(rear - 0.6 * rake, -half), body)]
    base = [(-half, 0), (half, 0), (half, 0.8 * body)]
    outline = rounded(polygon([*base, *windows, (-half, 0.95 * body)]), 0.06 * body)
    shell = bevelled(outline, width, draw.uniform("edge", 0.001, 0.008))
    shell = centred(shell, width, (90, 0, 0))
    wheel = draw.uniform("wheel", 0.07, 0.11) * length
    thick = 0.22 * width
    disc = centred(cylinder(wheel, thick, 0.12 * wheel, segments=32), thick, (90, 0, 0))
    axles = (-0.3 * length, 0.3 * length)
    out = draw.uniform("track", 0.4, 0.52) * width
    well = cylinder(1.12 * wheel, 0.5 * thick, segments=32).rotate((90, 0, 0))
    sides = (width / 2 + 0.1 * thick, -width / 2 + 0.4 * thick)
    wells = [well.translate((x, y, 0)) for x in axles for y in sides]
    discs = [disc.translate((x, side * out, 0.05 * wheel)) for x in axles for side in (-1, 1)]
    axle = centred(cylinder(0.35 * wheel, 2 * out, segments=16), 2 * out, (90, 0, 0))
    rods = [axle.translate((x, 0, 0.05 * wheel)) for x in axles]
    return union([shell - union(wells), *discs, *rods])


def animal(draw: Draw) -> Manifold:
    """A toy animal or doll: trunk, head, two or four legs, ears or a tail, all of ellipsoids."""
    trunk = draw.uniform("trunk", 0.022, 0.045)
    stretch = draw.uniform("stretch", 1.1, 1.9)
    girth = draw.uniform("girth", 0.75, 1.1)
    legs = draw.choice("legs", (2, 4, 4))
    leg_length = trunk * draw.uniform("leg_length", 0.9, 1.9)
    leg = trunk * draw.uniform("leg_radius", 0.22, 0.38)
    head = trunk * draw.uniform("head", 0.45, 0.8)
    parts = [ellipsoid((trunk * stretch, trunk * girth, trunk), segments=40)]
    fore = 0.62 * trunk * stretch
    for x in (-fore, fore) if legs == 4 else (0.0,):
        for side in (-1, 1):
            hip = (x, side * 0.5 * girth * trunk, -0.3 * trunk)
            foot = (1.08 * x, side * 0.62 * girth * trunk, -0.5 * trunk - leg_length)
            bone, radii = np.linspace(hip, foot, 6), (1.1 * leg, 0.85 * leg)
            parts.append(tube(bone, radii, up=(1, 0, 0), corners=18))
    forward = trunk * stretch * draw.uniform("neck_forward", 0.6, 1.1)
    neck = (forward, 0, trunk * draw.uniform("neck_up", 0.5, 1.6))
    throat = np.linspace([0.4 * trunk * stretch, 0, 0], neck, 6)
    parts.append(tube(throat, (0.7 * head, 0.6 * head), up=(0, 1, 0), corners=18))
    snout = head * draw.uniform("snout", 1.0, 1.6)
    parts.append(ellipsoid((snout, head, head), neck, segments=32))
    ear = head * draw.uniform("ear", 0.3, 0.75)
    for side in (-1, 1):
        place = (neck[0] - 0.2 * head, side * 0.6 * head, neck[2] + 0.75 * head)
        parts.append(ellipsoid((0.3 * ear, 0.55 * ear, ear), place, segments=18))
    if draw.chance("tail", 0.6):
        root = (-0.85 * trunk * stretch, 0, 0.2 * trunk)
        bend = (-1.4 * trunk * stretch, 0, 0.5 * trunk)
        end = (-1.6 * trunk * stretch, 0, draw.uniform("tail_up", 0.0, 1.4) * trunk)
        tail = smooth_curve([root, bend, end], 10)
        parts.append(tube(tail, np.linspace(0.24, 0.12, 10) * trunk, up=(0, 1, 0), corners=12))
    return union(parts)


def toy_house(draw: Draw) -> Manifold:
    """A small house, church or bird house: block, gabled roof that overhangs, chimney, door."""
    width = draw.uniform("width", 0.04, 0.1)
    depth = width * draw.uniform("depth_ratio", 0.7, 1.5)
    height = width * draw.uniform("height_ratio", 0.5, 1.3)
    rise = width * draw.uniform("roof_ratio", 0.25, 0.7)
    eave = draw.uniform("eave", 0.002, 0.01)
    gable = symmetric([(width / 2, 0), (width / 2, height), (0, height + rise)])
    house = centred(bevelled(gable, depth, 0.0005), depth, (90, 0, 0))
    out, low = width / 2 + eave, height - eave * 2 * rise / width
    slope = [(-out, low), (0, height + rise), (out, low)]
    long = depth + 2 * eave
    roof = stroke(slope, draw.uniform("roof_thickness", 0.003, 0.008)).extrude(long)
    parts = [house, centred(roof, long, (90, 0, 0))]
    if draw.chance("chimney", 0.5):
        stack = rounded_box((0.16 * width, 0.16 * width, rise), 0.0008)
        parts.append(stack.translate((0.25 * width, 0.2 * depth, height + 0.3 * rise)))
    solid = union(parts)
    if draw.chance("door", 0.6):
        hole = cylinder(0.16 * width, 0.4 * depth, segments=28).rotate((90, 0, 0))
        solid -= hole.translate((0, -0.2 * depth, 0.5 * height))
    return solid


def top_toy(draw: Draw) -> Manifold:
    """A skittle, spinning top, chess man or doll: a turned body with a round head."""
    radius = draw.uniform("radius", 0.014, 0.045)
    height = radius * draw.uniform("height_ratio", 1.8, 5.0)
    waist = radius * draw.uniform("waist_ratio", 0.25, 0.7)
    head = radius * draw.uniform("head_ratio", 0.45, 0.9)
    z = np.linspace(0, height, 34)
    at = np.array([0, 0.08, 0.3, 0.72, 1.0]) * height
    shape = smooth_steps(at, [0.85 * radius, radius, 0.9 * radius, waist, waist], z)
    body = loft_sections(z, shape, shape)
    radii = (head, head, head * draw.uniform("head_stretch", 0.8, 1.4))
    parts = [body, ellipsoid(radii, (0, 0, height + 0.4 * head), segments=36)]
    if draw.chance("collar", 0.4):
        ring = turn([(0, -0.003), (1.25 * waist, -0.001), (1.25 * waist, 0.001), (0, 0.003)])
        parts.append(ring.translate((0, 0, 0.8 * height)))
    return union(parts)


FAMILIES = (
    Family("aeroplane", aeroplane, 2.5, "compound", 0.003),
    Family("toy_car", toy_car, 1.5, "toy", 0.003),
    Family("animal", animal, 1.5, "compound", 0.008),
    Family("toy_house", toy_house, 1.0, "toy", 0.003, 0),
    Family("top_toy", top_toy, 1.0, "toy", 0.004, 0),
)
