"""Hand tools with a handle: hammers, screwdrivers, drills, brushes."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import ellipse, smooth_curve, smooth_steps
from pointsdf_cli.objects.solids import (
    centred,
    cylinder,
    loft_sections,
    rounded_box,
    tube,
    turn,
    union,
)

# Widths and depths of a screwdriver's tip, as multiples of the shaft's, exponent and corners.
_TIPS = {
    "flat": ((0.9, 0.95, 1.5, 1.5), (0.9, 0.9, 0.3, 0.25), 3.0, 20),
    "cross": ((0.9, 0.95, 0.45, 0.25), (0.9, 0.95, 0.45, 0.25), 1.0, 20),
    "pointed": ((0.95, 0.95, 0.3, 0.15), (0.95, 0.95, 0.3, 0.15), 2.0, 16),
}


def hammer(draw: Draw) -> Manifold:
    """A claw hammer, mallet or ball-peen hammer, lying."""
    length = draw.uniform("length", 0.17, 0.34)
    grip = draw.uniform("grip_radius", 0.010, 0.018)
    neck = grip * draw.uniform("neck_ratio", 0.5, 0.95)
    at = np.linspace(0, length, 16)
    widths = [0.9, 1.0, 0.85, neck / grip, neck / grip]
    width = smooth_steps([0, 0.08, 0.35, 0.55, 1.0], widths, at / length)
    path = np.column_stack([np.zeros_like(at), at, np.zeros_like(at)])
    handle = tube(path, grip * width, grip * width * draw.uniform("grip_flatness", 0.65, 1.0))
    face = draw.uniform("face_radius", 0.010, 0.03)
    half = draw.uniform("head_half_length", 0.03, 0.065)
    form = draw.choice("form", ("claw", "claw", "mallet", "peen", "sledge"))
    if form == "mallet":
        drum = cylinder(1.2 * face, 2 * half, draw.uniform("drum_edge", 0.001, 0.006))
        head = centred(drum, 2 * half, (0, 90, 0))
    elif form == "sledge":
        block = rounded_box((2 * face, 2 * face, 2 * half), 0.004)
        head = centred(block, 2 * half, (0, 90, 0))
    else:
        profile = [(face, 0), (face, 0.3 * half), (0.65 * face, 0.45 * half), (0.75 * face, half)]
        head = centred(turn(profile, fillet=0.001, segments=32), 2 * half, (0, 90, 0))
        block = rounded_box((1.9 * face, 1.7 * face, 1.7 * face), 0.3 * face)
        if form == "peen":
            back = Manifold.sphere(0.85 * face, 24).translate((1.25 * face, 0, 0))
        else:
            back = _claw(draw, face, half)
        head = union([head, centred(block, 1.7 * face), back])
    return union([handle, head.translate((0, length - 0.4 * face, 0))])


def _claw(draw: Draw, face: float, half: float) -> Manifold:
    """Two bent prongs that leave the head along +x and dive towards −y."""
    drop = draw.uniform("claw_drop", 0.2, 0.7) * half
    spread = draw.uniform("claw_spread", 0.3, 0.55) * face
    reach = half * draw.uniform("claw_reach", 1.0, 1.5)
    prongs = []
    for side in (-1.0, 1.0):
        bend = (0.5 * reach, -0.15 * drop, 0.7 * side * spread)
        tip = (reach, -drop, 1.2 * side * spread)
        path = smooth_curve([(0.2 * face, 0, 0.35 * side * spread), bend, tip], 12)
        thick, wide = (0.42 * face, 0.12 * face), (0.5 * face, 0.28 * face)
        prongs.append(tube(path, thick, wide, exponent=3.0))
    return union(prongs)


def screwdriver(draw: Draw) -> Manifold:
    """A screwdriver, awl or file, lying: fluted or smooth handle, shaft, shaped tip."""
    grip = draw.uniform("grip_radius", 0.009, 0.018)
    handle_length = draw.uniform("handle_length", 0.06, 0.115)
    shaft = grip * draw.uniform("shaft_ratio", 0.14, 0.35)
    shaft_length = draw.uniform("shaft_length", 0.05, 0.18)
    waist = draw.uniform("waist", 0.55, 0.95)
    z = np.linspace(0, handle_length, 24)
    at = [0, 0.03, 0.12, 0.55, 0.8, 0.93, 1.0]
    radii = [0.6, 0.85, 1.0, 0.95, waist, 0.95 * waist + 0.03, 0.5 * waist]
    shape = grip * smooth_steps(at, radii, z / handle_length)
    handle = loft_sections(z, shape, shape, corners=36)
    flutes = draw.integer("flutes", 0, 8)
    if flutes >= 3:
        flute = grip * draw.uniform("flute_ratio", 0.18, 0.35)
        groove = cylinder(flute, 0.6 * handle_length, segments=14)
        places = ellipse(1.12 * grip, 1.12 * grip, flutes) + [0, 0, 0.12 * handle_length]
        handle -= union([groove.translate(tuple(place)) for place in places])
    rod = cylinder(shaft, shaft_length + 0.01, segments=20).translate((0, 0, handle_length - 0.01))
    end = handle_length + shaft_length
    wide, deep, exponent, corners = _TIPS[draw.choice("tip", tuple(_TIPS))]
    z = np.array([-0.004, 0.0, 0.009, 0.012]) + end
    point = loft_sections(z, shaft * np.array(wide), shaft * np.array(deep), exponent, corners)
    return union([handle, rod, point]).rotate((0, 90, 0))


def power_drill(draw: Draw) -> Manifold:
    """A cordless drill or driver lying on its side: motor, chuck, pistol grip, battery."""
    radius = draw.uniform("motor_radius", 0.021, 0.032)
    length = draw.uniform("motor_length", 0.1, 0.15)
    chuck = draw.uniform("chuck_length", 0.025, 0.06)
    grip_length = draw.uniform("grip_length", 0.075, 0.12)
    grip = radius * draw.uniform("grip_ratio", 0.55, 0.75)
    rake = draw.uniform("rake", -0.1, 0.35)
    z = np.linspace(0, length, 20)
    at, radii = [0, 0.05, 0.2, 0.7, 0.9, 1], [0.6, 0.85, 1, 1, 0.85, 0.7]
    shape = radius * smooth_steps(at, radii, z / length)
    # Built with the bore along x and the grip along −y; it lies with its flat side down.
    deep = shape * draw.uniform("motor_flatness", 0.85, 1.1)
    motor = loft_sections(z, shape, deep, 2.6).rotate((0, 90, 0))
    nose = [(0.72 * radius, 0), (0.66 * radius, 0.6 * chuck), (0.3 * radius, chuck)]
    jaws = turn(nose, fillet=0.001, segments=28).rotate((0, 90, 0))
    root = np.array([length * draw.uniform("grip_at", 0.25, 0.5), -0.3 * radius, 0])
    foot = root + np.array([-np.sin(rake), -np.cos(rake), 0]) * (grip_length + radius)
    path = np.linspace(root, foot, 12)
    girth = grip * smooth_steps([0, 0.25, 0.6, 1], [1.25, 1.0, 1.05, 1.2], np.linspace(0, 1, 12))
    handle = tube(path, 1.15 * girth, 0.85 * girth, exponent=2.6, round_ends=False)
    parts = [motor, jaws.translate((length - 0.003, 0, 0)), handle]
    if draw.chance("battery", 0.8):
        long = draw.uniform("battery_length", 0.06, 0.11)
        high = draw.uniform("battery_height", 0.02, 0.045)
        wide = draw.uniform("battery_width", 0.045, 0.07)
        pack = rounded_box((long, high, wide), 0.006).translate((0, 0, -wide / 2))
        parts.append(pack.translate((float(foot[0]) + 0.006, float(foot[1]), 0)))
    if draw.chance("bit", 0.5):
        bit = cylinder(0.003, draw.uniform("bit_length", 0.03, 0.07), segments=12)
        parts.append(bit.rotate((0, 90, 0)).translate((length + chuck - 0.008, 0, 0)))
    trigger = rounded_box((0.014, 0.026, 0.014), 0.004).translate((0, 0, -0.007))
    at = root + (foot - root) * 0.3 + np.array([1.2 * grip, 0, 0])
    return union([*parts, trigger.translate(tuple(map(float, at)))])


def brush(draw: Draw) -> Manifold:
    """A paint, tooth, dish or scrubbing brush, lying: a handle that ends in a block of bristles."""
    length = draw.uniform("length", 0.1, 0.22)
    grip = draw.uniform("grip", 0.006, 0.014)
    across = draw.chance("bristles_across", 0.5)
    t = np.linspace(0, 1, 20)
    wave = draw.uniform("wave", -0.15, 0.25)
    width = grip * smooth_steps([0, 0.2, 0.5, 0.8, 1], [0.7, 1.0, 0.55 + wave, 0.9, 1.0], t)
    path = np.column_stack([length * t, np.zeros_like(t), np.zeros_like(t)])
    handle = tube(path, width, np.minimum(0.6 * width, 0.006))
    tuft = draw.uniform("tuft", 0.02, 0.05)
    if across:
        block = rounded_box((tuft * 1.6, max(2.2 * grip, 0.3 * tuft), tuft * 0.5), 0.002)
        return union([handle, block.translate((length - 0.5 * tuft, 0, 0))]).rotate((90, 0, 0))
    z = np.array([0.0, 0.15, 0.3, 0.9, 1.0]) * tuft * 1.8
    fan = draw.uniform("fan", 0.9, 1.6)
    wide = tuft * 0.4 * np.array([0.9, 1.0, 1.0, fan, 0.85 * fan])
    deep = grip * np.array([0.8, 0.9, 0.9, 0.8, 0.5])
    head = loft_sections(z, wide, deep, 4.0).rotate((0, 0, 90)).rotate((0, 90, 0))
    return union([handle, head.translate((length - 0.01, 0, 0))])


FAMILIES = (
    Family("hammer", hammer, 2.0, "tool", 0.003, 0),
    Family("screwdriver", screwdriver, 2.0, "tool", 0.003, 0),
    Family("power_drill", power_drill, 2.5, "compound", 0.003, 0),
    Family("brush", brush, 1.5, "flat", 0.004, 0),
)
