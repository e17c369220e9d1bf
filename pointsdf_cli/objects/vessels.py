"""Thin-walled vessels of revolution: cups, mugs, bowls, plates, glasses, pots, tins.

All are a wall of even thickness around a centre line in the (radius, z) half plane; handles are cut
by the vessel's own cavity, so that they never reach inside.
"""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.refine import refine
from pointsdf_cli.objects.sections import smooth_curve, soften, stroke
from pointsdf_cli.objects.solids import centred, cylinder, rounded_box, tube, turn, union
from pointsdf_cli.objects.walls import (
    THICKEST_WALL,
    THINNEST_WALL,
    cavity,
    ear,
    shell,
    side_handle,
    wall_thickness,
)


def mug(draw: Draw) -> Manifold:
    """A mug or tea cup with one handle."""
    radius = draw.uniform("radius", 0.032, 0.052)
    height = radius * draw.uniform("height_ratio", 1.3, 2.7)
    wall = max(wall_thickness(draw), 0.002)
    foot, belly = draw.uniform("foot_ratio", 0.6, 1.0), draw.uniform("belly_ratio", 0.95, 1.15)
    bottom = [(0, 0), (foot * radius, 0), (0.5 * (foot + belly) * radius, 0.2 * height)]
    side = [(belly * radius, 0.5 * height), (radius, 0.8 * height), (radius, height)]
    line = soften([*bottom, *side])
    thick = draw.uniform("handle_radius", 0.0032, 0.006)
    flat = draw.uniform("handle_flatness", 0.8, 1.8)
    reach = draw.uniform("handle_reach", 0.02, 0.035) + thick
    low = height * draw.uniform("handle_low", 0.12, 0.3)
    high = height * draw.uniform("handle_high", 0.75, 0.9)
    # A loop that a finger, or at least a ray, still passes through.
    high = max(high, low + 4 * thick + 0.008)
    squareness = draw.uniform("handle_squareness", 0, 1)
    handle = side_handle(line, low, high, reach, squareness, thick, thick * flat)
    return union([shell(line, wall), handle - cavity(line, wall)])


def bowl(draw: Draw) -> Manifold:
    """An open bowl, from finger bowl to mixing bowl, perhaps with a lip and a foot ring."""
    radius = draw.uniform("radius", 0.045, 0.14)
    height = radius * draw.uniform("height_ratio", 0.4, 1.0)
    wall = wall_thickness(draw)
    foot = radius * draw.uniform("foot_ratio", 0.3, 0.65)
    power = draw.uniform("roundness", 1.2, 2.6)
    t = np.linspace(0, 1, 14)
    side = np.column_stack([foot + (radius - foot) * (1 - (1 - t) ** power), height * t])
    line = np.concatenate([[(0, 0)], side])
    if draw.chance("lip", 0.45):
        lip = draw.uniform("lip_width", 0.003, 0.012)
        line = np.concatenate([line, [(radius + lip, height + 0.2 * lip)]])
    parts = [shell(soften(line, 2), wall)]
    if draw.chance("foot_ring", 0.5):
        ring = stroke([(0.9 * foot, -0.004), (0.9 * foot, 0.002)], max(wall, 0.002))
        parts.append(turn(ring))
    return union(parts)


def plate(draw: Draw) -> Manifold:
    """A plate or saucer: flat middle, raised rim."""
    radius = draw.uniform("radius", 0.06, 0.14)
    wall = draw.log_uniform("wall", 0.0015, THICKEST_WALL)
    well = radius * draw.uniform("well_ratio", 0.5, 0.8)
    rise = draw.uniform("rise", 0.008, 0.03)
    step = draw.uniform("step", 0.2, 0.9)
    line = [(0, 0), (well, 0), (well + 0.2 * (radius - well), step * rise), (radius, rise)]
    parts = [shell(soften(line), wall)]
    if draw.chance("foot_ring", 0.5):
        parts.append(turn(stroke([(0.85 * well, -0.003), (0.85 * well, 0.001)], 0.003)))
    return union(parts)


def tumbler(draw: Draw) -> Manifold:
    """A drinking glass, paper cup, beaker or pot: straight or tapered, either way up."""
    radius = draw.uniform("radius", 0.022, 0.06)
    height = radius * draw.uniform("height_ratio", 1.0, 3.6)
    wall = wall_thickness(draw)
    foot = radius * draw.uniform("foot_ratio", 0.6, 1.02)
    waist = draw.uniform("waist", -0.08, 0.06) * radius
    middle = 0.5 * (foot + radius) + waist
    corner = draw.uniform("corner", 0.0, 0.3)
    bottom = [(foot * (1 - corner), 0), (foot, 0.3 * corner * height)]
    side = soften([*bottom, (middle, height / 2), (radius, height)], 2)
    line = np.concatenate([[(0, 0)], side])
    cup = shell(line, wall)
    if draw.chance("thick_base", 0.3):
        plug = cylinder(foot - 0.2 * wall, draw.uniform("base", 0.004, 0.015), 0.0005, segments=48)
        cup = union([cup, plug])
    return cup.rotate((180, 0, 0)) if draw.chance("upside_down", 0.2) else cup


def rim_cup(draw: Draw) -> Manifold:
    """A stacking cup: straight wall, rolled rim that stands out, stepped-in foot."""
    radius = draw.uniform("radius", 0.022, 0.055)
    height = radius * draw.uniform("height_ratio", 1.3, 2.4)
    wall = draw.log_uniform("wall", 0.0014, 0.003)
    step = draw.uniform("step", 0.001, 0.004)
    step_height = height * draw.uniform("step_at", 0.06, 0.2)
    roll = draw.uniform("roll", 0.0025, 0.006)
    foot = [(radius - step, 0), (radius - step, step_height), (radius, step_height + 0.002)]
    rim = [(radius + 0.3 * roll, height), (radius + 1.2 * roll, height - 0.3 * roll)]
    side = soften([*foot, (radius, height - roll), *rim], 2)
    cup = shell(np.concatenate([[(0, 0)], side]), wall)
    return cup.rotate((180, 0, 0)) if draw.chance("upside_down", 0.2) else cup


def wine_glass(draw: Draw) -> Manifold:
    """A stemmed glass, goblet or egg cup."""
    radius = draw.uniform("radius", 0.025, 0.045)
    bowl_height = radius * draw.uniform("bowl_ratio", 1.0, 2.4)
    stem = radius * draw.uniform("stem_ratio", 0.3, 2.0)
    wall = draw.log_uniform("wall", THINNEST_WALL, 0.003)
    foot = radius * draw.uniform("foot_ratio", 0.7, 1.05)
    mouth = radius * draw.uniform("mouth_ratio", 0.75, 1.1)
    thick = draw.uniform("stem_radius", 0.003, 0.006)
    radii = [0, 0.6 * radius, 1.05 * radius, 0.97 * radius, mouth]
    line = np.column_stack([radii, stem + bowl_height * np.array([0, 0.08, 0.35, 0.7, 1])])
    base = [(foot, 0), (foot, 0.0015), (1.5 * thick, 0.006), (thick, 0.012 + 0.1 * stem)]
    top = [(thick, stem - 0.05 * stem), (1.8 * thick, stem + 0.02 * bowl_height)]
    if stem < 0.014:
        base = base[:-1]
    return union([shell(soften(line), wall), turn(base + top, fillet=0.0006)])


def pan(draw: Draw) -> Manifold:
    """A pan or pot: shallow to deep, with a long handle, two loops or two lugs."""
    radius = draw.uniform("radius", 0.05, 0.11)
    height = radius * draw.uniform("height_ratio", 0.3, 1.2)
    wall = draw.log_uniform("wall", 0.0015, 0.004)
    flare = draw.uniform("flare", 0.0, 0.2)
    foot, middle = radius * (1 - flare), radius * (1 - 0.3 * flare)
    line = soften([(0, 0), (foot, 0), (middle, 0.4 * height), (radius, height)])
    level = 0.75 * height
    start = float(np.interp(level, line[:, 1], line[:, 0]))
    if draw.chance("long_handle", 0.6):
        reach = draw.uniform("handle", 0.09, 0.17)
        lift = draw.uniform("handle_lift", 0.0, 0.25) * reach
        half_way = (start + reach / 2, 0, level + 0.3 * lift)
        knots = [(start, 0, level), half_way, (start + reach, 0, level + lift)]
        ends = draw.uniform("grip_start", 0.003, 0.006), draw.uniform("grip_end", 0.006, 0.011)
        grip = np.linspace(*ends, 12)
        handles = [tube(smooth_curve(knots, 12), 0.55 * grip, grip, up=(0, 1, 0))]
    else:
        span = draw.uniform("loop_span", 0.025, 0.05)
        reach = draw.uniform("loop_reach", 0.018, 0.035)
        thick = draw.uniform("loop_radius", 0.003, 0.005)
        loop = ear((0.9 * start, -span / 2), (0.9 * start, span / 2), reach, 0.7, thick, thick)
        loop = loop.rotate((90, 0, 0)).translate((0, 0, level))
        handles = [loop, loop.rotate((0, 0, 180))]
    return union([shell(line, wall), union(handles) - cavity(line, wall)])


def open_tin(draw: Draw) -> Manifold:
    """An opened tin or tube: straight wall, open top, perhaps ribs; standing, or upside down."""
    radius = draw.uniform("radius", 0.025, 0.055)
    height = radius * draw.uniform("height_ratio", 0.6, 3.5)
    wall = draw.log_uniform("wall", THINNEST_WALL, 0.003)
    ribs = draw.integer("ribs", 0, 6)
    z = np.linspace(0.1, 0.9, 4 * ribs + 2) * height
    ripple = 0.0006 * (1 - np.cos(np.linspace(0, 2 * np.pi * ribs, len(z))))
    side = np.column_stack([radius - ripple, z])
    tin = shell([(0, 0), (radius, 0), *side, (radius, height)], wall)
    return tin.rotate((180, 0, 0)) if draw.chance("upside_down", 0.15) else tin


def flower_pot(draw: Draw) -> Manifold:
    """A tapered pot with a thick band at the rim, and sometimes a hole in the bottom."""
    radius = draw.uniform("radius", 0.03, 0.08)
    height = radius * draw.uniform("height_ratio", 1.2, 2.2)
    wall = draw.uniform("wall", 0.002, 0.0055)
    foot = radius * draw.uniform("foot_ratio", 0.55, 0.8)
    band = height * draw.uniform("band", 0.15, 0.3)
    line = np.array([(0, 0), (foot, 0), (radius, height)])
    middle = float(np.interp(height - band, [0, height], [foot, radius]))
    rim = stroke([(middle + wall / 2, height - band), (radius + wall / 2, height)], 1.3 * wall)
    pot = union([shell(line, wall), turn(rim) - cavity(line, wall)])
    if draw.chance("hole", 0.5):
        hole = draw.uniform("hole_radius", 0.003, 0.008)
        pot -= centred(cylinder(hole, 0.02, segments=24), 0.02)
    return pot


def lid(draw: Draw) -> Manifold:
    """A pot or jar lid lying open side down, with a knob, or a flat one without."""
    radius = draw.uniform("radius", 0.03, 0.11)
    wall = draw.log_uniform("wall", 0.0014, 0.004)
    skirt = draw.uniform("skirt", 0.004, 0.018)
    dome = radius * draw.uniform("dome", 0.0, 0.35)
    t = np.linspace(0, 1, 10)
    top = np.column_stack([radius * t, skirt + dome * (1 - t**2)])
    cover = shell(np.concatenate([top, [(radius, 0)]]), wall)
    if not draw.chance("knob", 0.6):
        return cover
    knob = draw.uniform("knob_radius", 0.008, 0.018)
    rise = draw.uniform("knob_rise", 0.01, 0.025)
    profile = [(0.5 * knob, 0), (0.5 * knob, 0.4 * rise), (knob, 0.6 * rise), (knob, rise)]
    return union([cover, turn(profile, fillet=0.001).translate((0, 0, skirt + dome))])


def tray(draw: Draw) -> Manifold:
    """An open box, tray, drawer or crate with flat or slightly drafted walls."""
    length = draw.uniform("length", 0.07, 0.3)
    width = length * draw.uniform("width_ratio", 0.45, 1.0)
    height = width * draw.uniform("height_ratio", 0.15, 0.9)
    wall = draw.log_uniform("wall", 0.0015, THICKEST_WALL)
    corner = draw.uniform("corner", 0.002, 0.12 * length)
    draft = draw.uniform("draft", 0.0, 0.2)
    corner = min(corner, 0.45 * width, 0.9 * height)
    outer = rounded_box((width, length, 2 * height), corner)
    inside = (width - 2 * wall, length - 2 * wall, 2 * height)
    room = rounded_box(inside, max(corner - wall, 0.0005))
    box = (outer - room.translate((0, 0, wall))).trim_by_plane((0, 0, -1), -height)

    def lean(points: np.ndarray) -> np.ndarray:
        """Lean the walls outwards, as those of anything that is moulded."""
        wider = 1 + draft * (points[:, 2] / height - 0.5)
        return points * np.column_stack([wider, wider, np.ones_like(wider)])

    return refine(box, length / 8).warp_batch(lean)


FAMILIES = (
    Family("mug", mug, 3.0, "vessel", 0.002, 1),
    Family("bowl", bowl, 3.0, "vessel", 0.003, 0),
    Family("plate", plate, 2.0, "vessel", 0.003, 0),
    Family("tumbler", tumbler, 2.5, "vessel", 0.002, 0),
    Family("rim_cup", rim_cup, 3.0, "vessel", 0.002, 0),
    Family("wine_glass", wine_glass, 1.0, "vessel", 0.002, 0),
    Family("pan", pan, 1.5, "vessel", 0.002),
    Family("open_tin", open_tin, 1.5, "vessel", 0.003, 0),
    Family("flower_pot", flower_pot, 1.0, "vessel", 0.003),
    Family("lid", lid, 1.0, "vessel", 0.003, 0),
    Family("tray", tray, 1.5, "vessel", 0.003, 0),
)
