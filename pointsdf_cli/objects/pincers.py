"""Tools of flat levers and jaws, lying: spanners, scissors, pliers, clamps, keys."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold, OpType

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import (
    arc,
    ellipse,
    polygon,
    rounded,
    smooth_curve,
    smooth_steps,
    stroke,
)
from pointsdf_cli.objects.solids import bevelled, centred, cylinder, rounded_box, tube, union


def wrench(draw: Draw) -> Manifold:
    """A spanner, lying flat: open jaw, ring or adjustable jaw at either end of a bar."""
    length = draw.uniform("length", 0.1, 0.27)
    head = length * draw.uniform("head_ratio", 0.085, 0.13)
    bar = head * draw.uniform("bar_ratio", 0.5, 0.85)
    thickness = draw.uniform("thickness", 0.004, 0.011)
    outline = stroke([(0, 0), (0, length)], bar)
    cuts = []
    for end, name in ((0.0, "near"), (length, "far")):
        kind = draw.choice(name, ("open", "ring", "plain"))
        size = head * draw.uniform(f"{name}_ratio", 0.75, 1.0)
        outwards = 1.0 if end > 0 else -1.0
        if kind == "plain":
            continue
        outline += CrossSection.circle(size, 32).translate((0, end))
        if kind == "ring":
            corners = draw.choice(f"{name}_corners", (6, 12, 24))
            cuts.append(CrossSection.circle(0.62 * size, corners).translate((0, end)))
        else:
            jaw = 2 * size * draw.uniform(f"{name}_jaw", 0.4, 0.55)
            slot = CrossSection.square((jaw, 2 * size), True).translate((0, outwards * 0.95 * size))
            tilt = draw.uniform(f"{name}_tilt", -25.0, 25.0)
            cuts.append(slot.rotate(tilt).translate((0, end)))
    if cuts:
        outline -= CrossSection.batch_boolean(cuts, OpType.Add)
    bevel = draw.uniform("bevel", 0.0003, 0.002)
    return bevelled(rounded(outline, 0.0008, 0.002), thickness, bevel)


def scissors(draw: Draw) -> Manifold:
    """Scissors or shears, lying: two crossed blades with finger loops, closed or ajar."""
    length = draw.uniform("length", 0.12, 0.22)
    blade = length * draw.uniform("blade_ratio", 0.45, 0.6)
    width = length * draw.uniform("blade_width", 0.055, 0.09)
    opening = draw.uniform("opening", 0.02, 0.35)
    thickness = draw.uniform("thickness", 0.0025, 0.005)
    loop_long = length * draw.uniform("loop_length", 0.11, 0.16)
    loop_wide = loop_long * draw.uniform("loop_ratio", 0.55, 0.85)
    rim = draw.uniform("loop_radius", 0.003, 0.0055)
    handle = length - blade - loop_long
    heel = [(-0.2 * width, -0.2 * width), (0.62 * width, -0.1 * width)]
    point = [(0.5 * width, 0.7 * blade), (0.06 * width, blade), (-0.12 * width, 0.7 * blade)]
    edge = rounded(polygon([*heel, *point]), 0.0008)
    x, y = -0.75 * loop_wide - 0.25 * width, -handle - 0.7 * loop_long
    loop = ellipse(loop_wide, loop_long, 28) + [x, y, 0]
    join = (x + 0.55 * loop_wide, y + 0.86 * loop_long, 0)
    knots = [(0.1 * width, 0.1 * width, 0), (-0.1 * width, -0.5 * handle, 0), join]
    halves = []
    for side in (-1.0, 1.0):
        plate = centred(bevelled(edge, thickness, 0.0005), thickness)
        ring = tube(loop, rim, 0.8 * rim + 0.5 * thickness, closed=True, corners=12)
        girth, high = (0.38 * width, 1.1 * rim), 0.5 * thickness + 0.4 * rim
        shank = tube(smooth_curve(knots, 10), girth, high, exponent=2.5)
        half = _turned(union([plate, ring, shank]), side, np.degrees(opening) / 2)
        halves.append(half.translate((0, 0, 0.24 * thickness * side)))
    pivot = cylinder(0.35 * width, 2.2 * thickness, 0.0006, segments=20)
    return union([*halves, centred(pivot, 2.2 * thickness)])


def _turned(half: Manifold, side: float, angle: float) -> Manifold:
    """Half of a tool turned by an angle [°] to its side, -1 or 1; mirrored for the latter."""
    mirrored = half.mirror((1, 0, 0)) if side > 0 else half
    return mirrored.rotate((0, 0, side * angle))


def pliers(draw: Draw) -> Manifold:
    """Pliers or tongs, lying: two bent levers crossed at a pivot."""
    length = draw.uniform("length", 0.13, 0.22)
    jaw = length * draw.uniform("jaw_ratio", 0.2, 0.38)
    gap = draw.uniform("gap", 0.012, 0.03)
    thickness = draw.uniform("thickness", 0.006, 0.012)
    grip = draw.uniform("grip_radius", 0.005, 0.009)
    bow = draw.uniform("bow", 0.4, 1.2)
    opening = draw.uniform("opening", 0.0, 0.2)
    elbow = (-gap * (0.7 + 0.3 * bow), -0.42 * (length - jaw), 0)
    knots = [(0, 0, 0), (-0.55 * gap, -0.15 * length, 0), elbow, (-gap, -(length - jaw), 0)]
    root = [(-0.9 * grip, -grip), (1.6 * grip, -grip)]
    tip = [(1.6 * grip, 0.3 * jaw), (0.5 * grip, jaw), (-0.05 * grip, jaw)]
    nose = rounded(polygon([*root, *tip]), 0.001)
    levers = []
    for side in (-1.0, 1.0):
        lever = tube(smooth_curve(knots, 18), (1.2 * grip, grip), (0.5 * thickness, grip))
        plate = centred(bevelled(nose, thickness, 0.001), thickness)
        levers.append(_turned(union([lever, plate]), side, -np.degrees(opening) / 2))
    hinge = cylinder(1.9 * grip, 1.3 * thickness, 0.001, segments=28)
    return union([*levers, centred(hinge, 1.3 * thickness)])


def spring_clamp(draw: Draw) -> Manifold:
    """A spring clamp, lying: two bent jaws around a pivot, with pads, ribs and long grips."""
    length = draw.uniform("length", 0.075, 0.21)
    width = length * draw.uniform("width_ratio", 0.12, 0.2)
    opening = draw.uniform("opening", 0.15, 0.9)
    spread = draw.uniform("grip_spread", 0.45, 1.1)
    jaw = length * draw.uniform("jaw_ratio", 0.38, 0.5)
    bar = length * draw.uniform("bar_ratio", 0.05, 0.08)
    hollow = draw.chance("hollow_grips", 0.5)
    arms = []
    for side in (-1.0, 1.0):
        tip = np.array([jaw * np.cos(opening / 2), side * jaw * np.sin(opening / 2)])
        grip_length = length - jaw
        end = np.array([-grip_length * np.cos(spread / 2), side * grip_length * np.sin(spread / 2)])
        bulge = np.array([0.45 * jaw, side * (0.5 * jaw * np.sin(opening / 2) + 1.3 * bar)])
        root = np.array([0.0, side * 1.1 * bar])
        out = 0.4 * grip_length * np.sin(spread / 2) + 0.9 * bar
        knee = np.array([-0.35 * grip_length, side * out])
        line = smooth_curve([tip, bulge, root, knee, end], 18)
        at, widths = [0, 0.15, 0.45, 0.6, 1], np.array([0.6, 1.0, 1.5, 1.3, 1.0]) * bar
        girth = smooth_steps(at, widths, np.linspace(0, 1, 18))
        plate = centred(bevelled(stroke(line, 1.4 * girth), width, 0.12 * width), width)
        if hollow:
            plate -= stroke(line[11:17], 0.75 * girth[11:17]).extrude(0.62 * width)
        pad = centred(rounded_box((1.6 * bar, 0.9 * bar, 0.9 * width), 0.2 * bar), 0.9 * width)
        pad = pad.rotate((0, 0, float(side * np.degrees(opening) / 2)))
        inward = tip - side * np.array([0.4 * bar, 0.35 * bar])
        arms += [plate, pad.translate((float(inward[0]), float(inward[1]), 0))]
    pivot = cylinder(1.5 * bar, 0.96 * width, 0.001, segments=24).translate((0, 0, -0.48 * width))
    return union([*arms, pivot])


def c_clamp(draw: Draw) -> Manifold:
    """A C clamp, lying: a frame, a screw with a foot through its end, and a crossbar."""
    throat = draw.uniform("throat", 0.03, 0.1)
    depth = throat * draw.uniform("depth_ratio", 0.5, 1.0)
    bar = draw.uniform("bar", 0.008, 0.016)
    thickness = bar * draw.uniform("thickness_ratio", 0.5, 1.0)
    line = np.array([(0, throat), (-depth, throat), (-depth, 0), (0, 0)]) + [0, -throat / 2]
    frame = rounded(stroke(line, bar), 0.0, 0.3 * depth)
    body = bevelled(frame, thickness, 0.15 * thickness).translate((0, 0, -thickness / 2))
    screw = bar * draw.uniform("screw_ratio", 0.25, 0.4)
    travel = throat * draw.uniform("travel", 0.1, 0.75)
    tail = draw.uniform("tail", 0.02, 0.06)
    # The screw runs along y from its foot inside the throat to the crossbar outside.
    start, end = -throat / 2 + travel, throat / 2 + bar / 2 + tail
    along_y = (
        (cylinder(screw, end - start, segments=16), start),
        (cylinder(1.9 * screw, 0.007, 0.001, segments=24), start - 0.003),
        (cylinder(0.62 * bar, 1.5 * bar, 0.001, segments=24), throat / 2 - 0.75 * bar),
    )
    turned = [solid.rotate((-90, 0, 0)).translate((0, y, 0)) for solid, y in along_y]
    reach = draw.uniform("crossbar", 0.015, 0.035)
    cross = centred(cylinder(0.55 * screw, 2 * reach, segments=12), 2 * reach, (0, 90, 0))
    return union([body, *turned, cross.translate((0, end - screw, 0))])


def key(draw: Draw) -> Manifold:
    """A flat outline with a round head and a hole: keys, bottle openers, hooks, tags."""
    head = draw.uniform("head_radius", 0.011, 0.03)
    length = draw.uniform("length", 0.03, 0.11)
    bar = head * draw.uniform("bar_ratio", 0.3, 0.8)
    thickness = draw.uniform("thickness", 0.0025, 0.008)
    outline = CrossSection.circle(head, draw.choice("head_corners", (6, 8, 40)))
    outline += stroke([(0, 0), (length, 0)], bar)
    if draw.chance("hook", 0.35):
        bend = arc(1.4 * bar, -np.pi / 2, np.pi / 2, 12, (length, 1.4 * bar))
        outline += stroke(bend, 0.8 * bar)
    for tooth in range(draw.integer("teeth", 0, 4)):
        place = length * (0.6 + 0.12 * tooth)
        outline += CrossSection.square((0.06 * length, bar), True).translate((place, -0.6 * bar))
    hole = CrossSection.circle(head * draw.uniform("hole_ratio", 0.25, 0.6), 20)
    return bevelled(rounded(outline - hole.translate((-0.12 * head, 0)), 0.0006), thickness, 0.0008)


FAMILIES = (
    Family("scissors", scissors, 2.5, "flat", 0.003),
    Family("spring_clamp", spring_clamp, 3.0, "compound", 0.003),
    Family("wrench", wrench, 2.0, "flat", 0.002),
    Family("pliers", pliers, 1.5, "tool", 0.003),
    Family("c_clamp", c_clamp, 1.5, "compound", 0.002),
    Family("key", key, 1.0, "flat", 0.004),
)
