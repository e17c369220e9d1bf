"""Things with a hole: rolls of paper and tape, rings, doughnuts, chains, nuts."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from pointsdf_cli.geometry.frames import random_rotation
from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import ellipse, rounded
from pointsdf_cli.objects.solids import bevelled, tube, turn, union


def _annulus(outer: float, inner: float, height: float, fillet: float) -> Manifold:
    half = CrossSection.square((outer - inner, height)).translate((inner, 0))
    return rounded(half, min(fillet, 0.45 * (outer - inner), 0.45 * height)).revolve(52)


def paper_roll(draw: Draw) -> Manifold:
    """A roll of toilet or kitchen paper, standing or lying."""
    outer = draw.uniform("outer", 0.035, 0.07)
    inner = draw.uniform("inner", 0.016, min(0.026, 0.6 * outer))
    height = outer * draw.uniform("height_ratio", 1.4, 4.2)
    roll = _annulus(outer, inner, height, draw.uniform("edge", 0.0005, 0.006))
    roll = roll.scale((1, draw.uniform("oval", 0.85, 1.0), 1))
    return roll.rotate((90, 0, 0)) if draw.chance("lies", 0.4) else roll


def tape_roll(draw: Draw) -> Manifold:
    """A roll of tape or a bracelet: flat ring, its core standing a little proud."""
    outer = draw.uniform("outer", 0.02, 0.065)
    inner = outer * draw.uniform("inner_ratio", 0.5, 0.9)
    height = draw.uniform("height", 0.009, 0.055)
    core = min(0.3 * (outer - inner), 0.004)
    ring = _annulus(outer, inner + 0.5 * core, height, draw.uniform("edge", 0.0003, 0.0015))
    proud = draw.uniform("proud", 0.0, 0.002)
    inside = _annulus(inner + core, inner, height + 2 * proud, 0.0004).translate((0, 0, -proud))
    tape = union([ring, inside])
    return tape.rotate((90, 0, 0)) if draw.chance("upright", 0.3) else tape


def doughnut(draw: Draw) -> Manifold:
    """A doughnut, bagel, ring toy or tyre: a torus with a flattened or lumpy section."""
    radius = draw.uniform("radius", 0.016, 0.06)
    thick = radius * draw.uniform("thickness_ratio", 0.2, 0.78)
    flat = draw.uniform("flatness", 0.7, 1.3)
    lumps, depth = draw.integer("lumps", 2, 9), draw.uniform("lump_depth", 0.0, 0.1)
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    swell = thick * (1 + depth * np.cos(lumps * angle)) / (1 + depth)
    power = draw.uniform("section", 1.8, 3.2)
    path = ellipse(radius, radius, 48)
    return tube(path, swell, flat * thick, closed=True, corners=22, exponent=power)


def chain(draw: Draw) -> Manifold:
    """A length of chain, lying: oval links, each turned against the last and welded to it."""
    links = draw.integer("links", 3, 14)
    wire = draw.uniform("wire", 0.0022, 0.0048)
    long = wire * draw.uniform("link_ratio", 4.2, 6.0)
    wide = long * draw.uniform("width_ratio", 0.42, 0.66)
    link = tube(ellipse(long, wide, 22), wire, closed=True, corners=10, up=(0, 0, 1))
    # Overlapping by a little less than two wires: neighbours sink into each other and are one body.
    pitch = 2 * (long - 0.75 * wire)
    heading, place, parts = 0.0, np.zeros(3), []
    bend = draw.uniform("bend", -0.5, 0.5)
    for index in range(links):
        roll = 35.0 if index % 2 else -35.0
        parts.append(link.rotate((roll, 0, float(np.degrees(heading)))).translate(tuple(place)))
        heading_next = heading + bend + 0.25 * draw.rng.normal()
        middle = (heading + heading_next) / 2
        place = place + pitch * np.array([np.cos(middle), np.sin(middle), 0])
        heading = heading_next
    return union(parts)


def nut(draw: Draw) -> Manifold:
    """A nut, washer, gear or cookie cutter: a flat outline with corners and a hole."""
    radius = draw.uniform("radius", 0.016, 0.05)
    height = radius * draw.uniform("height_ratio", 0.15, 1.2)
    form = draw.choice("form", ("hexagon", "square", "gear", "star"))
    if form in ("hexagon", "square"):
        outline = CrossSection.circle(radius, 6 if form == "hexagon" else 4)
        waist = radius
    else:
        points = draw.integer("points", 5, 14)
        depth = draw.uniform("depth", 0.12, 0.4) if form == "star" else 0.18
        angle = np.linspace(0, 2 * np.pi, 12 * points, endpoint=False)
        wave = np.cos(points * angle)
        wave = np.tanh(4 * wave) if form == "gear" else wave
        reach = radius * (1 - depth * (1 - wave) / 2)
        outline = CrossSection([np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])])
        waist = radius * (1 - depth)
    outline = rounded(outline, 0.03 * radius)
    hole = CrossSection.circle(waist * draw.uniform("hole_ratio", 0.25, 0.6), 32)
    return bevelled(outline - hole, height, 0.1 * min(height, 0.4 * radius))


def ring_stack(draw: Draw) -> Manifold:
    """A toy tower of rings on a base: stacking rings, screw plugs, beehives."""
    base = draw.uniform("base_radius", 0.03, 0.06)
    count = draw.integer("rings", 2, 6)
    thick = draw.uniform("ring", 0.006, 0.013)
    taper = draw.uniform("taper", 0.35, 1.0)
    profile = [(base, 0.0), (base, 0.008)]
    level = 0.008
    for index in range(count):
        size = base * (0.95 - (0.95 - 0.9 * taper) * index / count)
        bow = np.linspace(-np.pi / 2, np.pi / 2, 7)
        x, z = size - thick + thick * np.cos(bow), level + thick * (1 + np.sin(bow))
        profile += zip(x, z, strict=True)
        level += 2 * thick
    tip = [(0.3 * base * taper, level), (0.25 * base * taper, level + 0.012), (0, level + 0.014)]
    return turn([*profile, *tip], fillet=0.0006)


def wire_shape(draw: Draw) -> Manifold:
    """Bent thick wire or cable: hooks, bows, horseshoes, carabiners, spectacles frames."""
    count = draw.integer("bends", 3, 6)
    size = draw.uniform("size", 0.035, 0.12)
    thick = size * draw.uniform("thickness_ratio", 0.04, 0.1)
    closed = draw.chance("closed", 0.5)
    turned = 2 * np.pi if closed else draw.uniform("turn", 3.2, 5.4)
    angle = np.linspace(0, turned, 64, endpoint=not closed)
    wobble = sum(
        draw.rng.normal() * 0.25 / order**1.2 * np.cos(order * angle + draw.rng.uniform(0, 6.28))
        for order in range(2, count)
    )
    reach = size * np.clip(1 + wobble, 0.5, 1.6)
    rise = draw.uniform("rise", 0.0, 0.2) * size * np.sin(2 * angle)
    path = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), rise])
    squash = draw.uniform("squash", 0.6, 1.0)
    return tube(path * [1, squash, 1], thick, closed=closed, corners=12)


def tilted_rings(draw: Draw) -> Manifold:
    """Two or three crossed hoops: puzzle rings, armillary toys, ball frames."""
    radius = draw.uniform("radius", 0.025, 0.06)
    wire = radius * draw.uniform("wire_ratio", 0.07, 0.16)
    hoop = tube(ellipse(radius, radius, 44), wire, closed=True, corners=12)
    turns = random_rotation(draw.rng, draw.integer("hoops", 2, 3))
    return union([hoop.transform(np.column_stack([turn_by, np.zeros(3)])) for turn_by in turns])


FAMILIES = (
    Family("paper_roll", paper_roll, 1.5, "round", 0.008, 1),
    Family("tape_roll", tape_roll, 1.5, "round", 0.003, 1),
    Family("doughnut", doughnut, 1.5, "round", 0.006, 1),
    Family("chain", chain, 1.5, "compound", 0.002),
    Family("nut", nut, 1.0, "flat", 0.002, 1),
    Family("ring_stack", ring_stack, 1.0, "toy", 0.004, 0),
    Family("wire_shape", wire_shape, 1.0, "compound", 0.003),
    Family("tilted_rings", tilted_rings, 0.5, "compound", 0.002),
)
