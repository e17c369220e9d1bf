"""Shapes beyond the list: plates on legs, bent sheets, random assemblies."""

from __future__ import annotations

import itertools

import numpy as np
from manifold3d import CrossSection, Manifold

from pointsdf_cli.geometry.frames import random_rotation
from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.refine import refine
from pointsdf_cli.objects.sections import rounded, smooth_steps
from pointsdf_cli.objects.solids import (
    bevelled,
    centred,
    cylinder,
    ellipsoid,
    loft_sections,
    rounded_box,
    tube,
    union,
)


def furniture(draw: Draw) -> Manifold:
    """A doll's chair, stool or table, or a stand: a plate on legs, perhaps with a back."""
    width = draw.uniform("width", 0.05, 0.15)
    depth = width * draw.uniform("depth_ratio", 0.7, 1.3)
    leg_height = width * draw.uniform("leg_ratio", 0.4, 1.2)
    seat = draw.uniform("seat", 0.004, 0.012)
    leg = draw.uniform("leg", 0.003, 0.007)
    splay = draw.uniform("splay", 0.0, 0.2)
    plate = rounded_box((width, depth, seat), 0.3 * seat)
    if draw.chance("round_seat", 0.3):
        plate = cylinder(0.5 * min(width, depth), seat, 0.3 * seat, segments=44)
        depth = width = 0.8 * min(width, depth)
    parts = [plate.translate((0, 0, leg_height))]
    for x, y in itertools.product((-1, 1), repeat=2):
        place = x * (width / 2 - 1.5 * leg), y * (depth / 2 - 1.5 * leg)
        head = np.array([*place, leg_height + 0.5 * seat])
        path = np.linspace(head * [1 + splay, 1 + splay, 0], head, 4)
        rod = tube(path, leg, up=(0, 1, 0), corners=12, exponent=2.5, round_ends=False)
        parts.append(rod)
    if draw.chance("back", 0.5):
        back = rounded_box((width * 0.9, 1.3 * seat, leg_height), 0.3 * seat)
        parts.append(back.translate((0, depth / 2 - 1.3 * seat, leg_height + 0.4 * seat)))
    return union(parts)


def assembly(draw: Draw) -> Manifold:
    """Two to five simple solids joined at random, for shapes that no family has."""
    size = draw.uniform("size", 0.025, 0.06)
    parts: list[Manifold] = []
    centres = [np.zeros(3)]
    for _ in range(draw.integer("parts", 2, 5)):
        extent = size * draw.rng.uniform(0.35, 1.2, 3)
        (a, b, c), shortest = map(float, extent), float(extent.min())
        form = int(draw.rng.integers(5))
        if form == 0:
            part = centred(rounded_box(2 * extent, 0.2 * shortest), 2 * c)
        elif form == 1:
            part = centred(cylinder(a, 2 * c, 0.15 * shortest), 2 * c)
        elif form == 2:
            part = ellipsoid(extent, segments=32)
        elif form == 3:
            z = np.linspace(-c, c, 12)
            shape = a * smooth_steps([-1, 0, 1], draw.rng.uniform(0.3, 1.0, 3), z / c)
            part = loft_sections(z, shape, shape * b / a, 2 + 3 * draw.rng.random())
        else:
            section = CrossSection.circle(a, int(draw.rng.integers(3, 9)))
            part = bevelled(section, 1.5 * c, 0.1 * shortest)
        turn_by = random_rotation(draw.rng, 1)[0] if draw.rng.random() < 0.5 else np.eye(3)
        base = centres[int(draw.rng.integers(len(centres)))]
        step = draw.rng.normal(size=3)
        centre = base + (step / np.linalg.norm(step)) * 0.75 * size * (len(parts) > 0)
        centres.append(centre)
        parts.append(part.transform(np.column_stack([turn_by, centre])))
    solid = union(parts)
    if draw.chance("drilled", 0.3):
        bore = 0.3 * size * draw.uniform("drill", 0.5, 1.0)
        drill = centred(cylinder(bore, 0.5, segments=28), 0.5)
        solid -= drill.transform(np.column_stack([random_rotation(draw.rng, 1)[0], centres[-1]]))
    return solid


def bent_plate(draw: Draw) -> Manifold:
    """A thin sheet bent once or twice: book ends, brackets, shelves, stands, shells."""
    width = draw.uniform("width", 0.03, 0.14)
    length = draw.uniform("length", 0.08, 0.24)
    sheet = draw.log_uniform("sheet", 0.0012, 0.006)
    bends = draw.integer("bends", 1, 3)
    corner = draw.uniform("corner", 0.001, 0.3 * width)
    outline = rounded(CrossSection.square((width, length), True), corner)
    if draw.chance("hole", 0.3):
        outline -= CrossSection.circle(0.2 * width, 28)
    plate = bevelled(outline, sheet, 0.25 * sheet).translate((0, 0, -sheet / 2))
    angles = draw.rng.uniform(-1.5, 1.5, bends)
    places = np.sort(draw.rng.uniform(-0.4, 0.4, bends)) * length
    sharp = draw.uniform("bend_length", 0.1, 0.35) * length

    fine = np.linspace(-0.52 * length, 0.52 * length, 240)
    heading = sum(
        a / 2 * np.tanh((fine - p) * 2 / sharp) for a, p in zip(angles, places, strict=True)
    )
    step = fine[1] - fine[0]
    along, rise = np.cumsum(np.cos(heading)) * step, np.cumsum(np.sin(heading)) * step

    def fold(points: np.ndarray) -> np.ndarray:
        tilt = np.interp(points[:, 1], fine, heading)
        y = np.interp(points[:, 1], fine, along) - points[:, 2] * np.sin(tilt)
        z = np.interp(points[:, 1], fine, rise) + points[:, 2] * np.cos(tilt)
        return np.column_stack([points[:, 0], y, z])

    return refine(plate, max(0.25 * sharp, 0.006)).warp_batch(fold)


FAMILIES = (
    Family("furniture", furniture, 1.0, "compound", 0.003),
    Family("assembly", assembly, 3.0, "compound", 0.006),
    Family("bent_plate", bent_plate, 1.5, "flat", 0.003),
)
