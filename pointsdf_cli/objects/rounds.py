"""Closed turned packages: food and drink cans, tubes of crisps, spray cans, jars, lights, pens."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import ellipse, smooth_steps
from pointsdf_cli.objects.solids import bevelled, cylinder, loft_sections, rounded_box, turn, union


def can(draw: Draw) -> Manifold:
    """A closed food tin: beaded rims, sunken ends, and perhaps ribs around the side."""
    radius = draw.uniform("radius", 0.028, 0.055)
    height = draw.log_uniform("height", 0.03, 0.18)
    bead = draw.uniform("bead", 0.0008, 0.0025)
    sunk = draw.uniform("sunk", 0.001, 0.005)
    ribs = draw.integer("ribs", 0, 8) if height > 0.06 else 0
    rib_depth = draw.uniform("rib_depth", 0.0004, 0.0014)
    bead_height = 0.003
    z = np.linspace(bead_height, height - bead_height, 4 * ribs + 2)
    ripple = rib_depth * 0.5 * (1 - np.cos(np.linspace(0, 2 * np.pi * ribs, len(z))))
    side = np.column_stack([radius - ripple, z])
    rim = radius + bead
    bottom = [(radius - 0.003, sunk), (radius - 0.002, 0), (rim, 0), (rim, bead_height)]
    top = [(r, height - z) for r, z in reversed(bottom)]
    return turn([*bottom, *side, *top], fillet=0.0005)


def drink_can(draw: Draw) -> Manifold:
    """A drawn aluminium can: necked at both ends, concave bottom, sunken lid with a ring pull."""
    radius = draw.uniform("radius", 0.026, 0.035)
    height = draw.uniform("height", 0.085, 0.17)
    neck = radius * draw.uniform("neck", 0.76, 0.92)
    shoulder = draw.uniform("shoulder", 0.008, 0.02)
    bottom = [(0, 0.006), (neck - 0.006, 0.003), (neck - 0.003, 0), (neck, 0)]
    side = [(radius, shoulder * 0.8), (radius, height - shoulder), (neck, height - 0.003)]
    seam = [(neck + 0.001, height), (neck - 0.002, height), (neck - 0.003, height - 0.004)]
    body = turn([*bottom, *side, *seam], fillet=0.0006)
    pull = rounded_box((0.5 * neck, 0.8 * neck, 0.0025), 0.001).translate((0, 0, height - 0.0045))
    return union([body, pull])


def crisps_tube(draw: Draw) -> Manifold:
    """A tall cardboard tube with a plastic lid that is wider than the tube."""
    radius = draw.uniform("radius", 0.025, 0.045)
    height = radius * draw.uniform("height_ratio", 2.5, 7.0)
    lid = draw.uniform("lid", 0.004, 0.02)
    overhang = draw.uniform("overhang", 0.0005, 0.002)
    dent = draw.uniform("sunk_lid", 0.0, 0.003)
    rim = radius + overhang
    body = [(radius, 0), (radius, height - lid)]
    cap = [(rim, height - lid), (rim, height), (rim - 0.003, height), (rim - 0.004, height - dent)]
    return turn([*body, *cap], fillet=0.0008)


def spray_can(draw: Draw) -> Manifold:
    """An aerosol can: straight body, domed shoulder, and a cap or a spray button."""
    radius = draw.uniform("radius", 0.018, 0.034)
    body = radius * draw.uniform("body_ratio", 3.0, 6.0)
    neck = radius * draw.uniform("neck_ratio", 0.45, 0.75)
    dome = radius * draw.uniform("dome_ratio", 0.3, 0.7)
    angle = np.linspace(0, np.pi / 2, 7)
    x, z = neck + (radius - neck) * np.cos(angle), body + dome * np.sin(angle)
    foot = [(radius - 0.004, 0.003), (radius - 0.003, 0), (radius, 0)]
    solid = turn([*foot, *np.column_stack([x, z])], fillet=0.0006)
    top = body + dome
    if draw.chance("cap", 0.55):
        cap = radius * draw.uniform("cap_ratio", 0.8, 0.98)
        length = draw.uniform("cap_length", 0.02, 0.05)
        taper = draw.uniform("cap_taper", 0.75, 1.0)
        profile = [(cap, 0), (cap * taper, length)]
        return union([solid, turn(profile, fillet=0.002).translate((0, 0, body + 0.2 * dome))])
    button = draw.uniform("button", 0.5, 0.9) * neck
    actuator = cylinder(button, 0.018, 0.002).translate((0, 0, top - 0.002))
    nozzle = cylinder(0.0025, 0.006, segments=12).rotate((0, 90, 0))
    return union([solid, actuator, nozzle.translate((button - 0.003, 0, top + 0.01))])


def jar(draw: Draw) -> Manifold:
    """A filled jar with its lid on: round or squarish, straight or bellied."""
    radius = draw.uniform("radius", 0.025, 0.055)
    height = radius * draw.uniform("height_ratio", 1.2, 3.2)
    belly = draw.uniform("belly", 0.95, 1.2)
    neck = draw.uniform("neck_ratio", 0.7, 0.95)
    exponent = draw.uniform("squareness", 2.0, 6.0) if draw.chance("square", 0.3) else 2.0
    z = np.concatenate([[0, 0.002], np.linspace(0.006, height, 22)])
    at = height * np.array([0, 0.02, 0.12, 0.45, 0.8, 0.93, 1.0])
    radii = radius * np.array([0.9, 0.95, 1.0, belly, 1.0, neck, neck])
    shape = smooth_steps(at, radii, z)
    power = smooth_steps(at, exponent + (2 - exponent) * np.array([0, 0, 0, 0, 0, 1, 1]), z)
    body = loft_sections(z, shape, shape, power)
    lid_radius = radius * min(neck * draw.uniform("lid_ratio", 1.02, 1.15), 1.05)
    lid_height = draw.uniform("lid_height", 0.008, 0.022)
    lid = cylinder(lid_radius, lid_height, 0.0012, segments=48)
    if draw.chance("knurled", 0.4):
        ridges = draw.integer("ridges", 24, 40)
        groove = cylinder(0.0012, lid_height * 0.7, segments=8)
        places = ellipse(lid_radius, lid_radius, ridges) - [0, 0, 1e-4]
        lid -= union([groove.translate(tuple(place)) for place in places])
    return union([body, lid.translate((0, 0, height - 0.35 * lid_height))])


def marker(draw: Draw) -> Manifold:
    """A pen, marker or lipstick lying on its side: a barrel, a wider cap, perhaps a clip."""
    radius = draw.uniform("radius", 0.004, 0.012)
    length = draw.uniform("length", 0.09, 0.17)
    cap_start = length * draw.uniform("cap_at", 0.55, 0.8)
    cap = radius * draw.uniform("cap_ratio", 1.02, 1.25)
    tail = radius * draw.uniform("tail_ratio", 0.6, 1.0)
    tip = cap * draw.uniform("tip_ratio", 0.6, 0.95)
    barrel = [(tail, 0), (radius, 0.012), (radius, cap_start)]
    top = [(cap, cap_start), (cap, length - 0.012), (tip, length)]
    pen = turn([*barrel, *top], fillet=0.0007, segments=28)
    if draw.chance("clip", 0.4):
        clip = rounded_box((0.004, 0.003, 0.6 * (length - cap_start)), 0.0008)
        pen = union([pen, clip.translate((cap, 0, cap_start + 0.3 * (length - cap_start)))])
    return pen.rotate((0, 90, 0))


def flashlight(draw: Draw) -> Manifold:
    """A torch lying on its side: a barrel that flares into a head with a sunken lens."""
    radius = draw.uniform("radius", 0.011, 0.022)
    length = draw.uniform("length", 0.1, 0.26)
    head = radius * draw.uniform("head_ratio", 1.15, 1.9)
    head_length = draw.uniform("head_length", 0.03, 0.06)
    flare = draw.uniform("flare", 0.01, 0.035)
    depth = draw.uniform("lens_depth", 0.002, 0.02)
    start = length - head_length
    barrel = [(radius * 0.9, 0), (radius, 0.008), (radius, start - flare)]
    lens = [(head, start), (head, length), (head - 0.003, length), (0.35 * head, length - depth)]
    light = turn([*barrel, *lens], fillet=0.0008, segments=40)
    if draw.chance("switch", 0.6):
        switch = rounded_box((0.008, 0.012, 0.025), 0.0025)
        light = union([light, switch.translate((radius - 0.002, 0, 0.45 * length))])
    return light.rotate((0, 90, 0))


def candle(draw: Draw) -> Manifold:
    """A plain or faceted column, cone or stack of discs: candles, salt mills, chess men."""
    radius = draw.uniform("radius", 0.012, 0.04)
    height = radius * draw.uniform("height_ratio", 1.5, 6.0)
    if draw.chance("faceted", 0.3):
        section = CrossSection.circle(radius, draw.integer("facets", 5, 10))
        return bevelled(section, height, draw.uniform("bevel", 0.001, 0.005))
    knots = draw.integer("knots", 2, 6)
    at = np.linspace(0, height, knots + 2)
    radii = radius * draw.rng.uniform(0.45, 1.0, knots + 2)
    radii[0] = radius
    z = np.linspace(0, height, 40)
    swell = smooth_steps(at, radii, z)
    return turn(np.column_stack([swell, z]), fillet=draw.uniform("fillet", 0.0008, 0.004))


FAMILIES = (
    Family("can", can, 5.0, "round", 0.004, 0),
    Family("drink_can", drink_can, 1.5, "round", 0.004, 0),
    Family("crisps_tube", crisps_tube, 1.5, "round", 0.005, 0),
    Family("spray_can", spray_can, 1.5, "round", 0.003, 0),
    Family("jar", jar, 2.0, "round", 0.004, 0),
    Family("marker", marker, 2.5, "tool", 0.004, 0),
    Family("flashlight", flashlight, 1.5, "tool", 0.003, 0),
    Family("candle", candle, 1.5, "round", 0.005, 0),
)
