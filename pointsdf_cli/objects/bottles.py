"""Bottles, jugs and pitchers: closed bodies with necks, handles, triggers and spouts."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.refine import refine
from pointsdf_cli.objects.sections import smooth_curve, smooth_steps, soften
from pointsdf_cli.objects.solids import (
    centred,
    cylinder,
    loft_sections,
    rounded_box,
    tube,
    turn,
    union,
)
from pointsdf_cli.objects.walls import cavity, shell, side_handle, solid_of


def screw_cap(draw: Draw, radius: float) -> Manifold:
    """A cap to close a neck of the given radius: straight, tapered, domed or with a nozzle."""
    wide = radius * draw.uniform("cap_ratio", 1.03, 1.3)
    length = draw.uniform("cap_length", 0.009, 0.03)
    taper = draw.uniform("cap_taper", 0.75, 1.0)
    profile = [(wide, 0), (wide, 0.4 * length), (wide * taper, length)]
    form = draw.choice("cap_form", ("flat", "flat", "dome", "nozzle"))
    if form == "dome":
        profile += [(0.7 * wide * taper, length + 0.35 * wide), (0.0, length + 0.5 * wide)]
    elif form == "nozzle":
        tip = draw.uniform("cap_nozzle", 0.012, 0.03)
        profile += [(0.5 * wide, length), (0.3 * wide, length + tip)]
    return turn(profile, fillet=0.0009, segments=40)


def bottle(draw: Draw) -> Manifold:
    """A round bottle: body, shoulder, neck and cap along one spline."""
    radius = draw.uniform("radius", 0.02, 0.048)
    height = radius * draw.uniform("height_ratio", 3.0, 6.5)
    neck = radius * draw.uniform("neck_ratio", 0.28, 0.6)
    shoulder, neck_at = draw.uniform("shoulder", 0.5, 0.75), draw.uniform("neck_at", 0.8, 0.93)
    waist = draw.uniform("waist", 0.82, 1.06)
    z = np.concatenate([[0, 0.0015, 0.004], np.linspace(0.008, height, 30)])
    at = height * np.array([0, 0.012, 0.05, 0.5 * shoulder, shoulder, neck_at, 1.0])
    radii = radius * np.array([0.88, 0.95, 1.0, waist, 1.0, neck / radius, neck / radius])
    shape = smooth_steps(at, radii, z)
    body = loft_sections(z, shape, shape)
    rings = draw.integer("rings", 0, 4)
    if rings:
        band = turn([(0.5, -0.002), (0.5, 0.002)])
        levels = np.linspace(0.15, 0.85, rings) * shoulder * height
        grooves = []
        for level in levels:
            inner = cylinder(float(np.interp(level, z, shape)) - 0.0012, 0.01)
            grooves.append((band - centred(inner, 0.01)).translate((0, 0, float(level))))
        body -= union(grooves)
    return union([body, screw_cap(draw, neck).translate((0, 0, height - 0.004))])


def squeeze_bottle(draw: Draw) -> Manifold:
    """A flat plastic bottle: mustard, shampoo, lotion; oval or boxy, waisted, with a cap."""
    half_width = draw.uniform("half_width", 0.026, 0.052)
    half_depth = half_width * draw.uniform("depth_ratio", 0.42, 0.85)
    height = half_width * draw.uniform("height_ratio", 2.6, 5.0)
    neck = min(half_depth * draw.uniform("neck_ratio", 0.45, 0.85), 0.02)
    exponent = draw.uniform("squareness", 2.0, 4.5)
    waist, lean = draw.uniform("waist", 0.75, 1.1), draw.uniform("top_ratio", 0.7, 1.05)
    z = np.concatenate([[0, 0.002, 0.005], np.linspace(0.01, height, 28)])
    at = height * np.array([0, 0.012, 0.05, 0.4, 0.72, 0.9, 0.94, 1.0])
    wide = half_width * np.array([0.85, 0.94, 1.0, waist, lean, 0.6 * lean, 0, 0])
    deep = half_depth * np.array([0.82, 0.93, 1.0, 0.5 + 0.5 * waist, 0.96, 0.75, 0, 0])
    wide[-2:], deep[-2:] = neck, neck
    wide[-3], deep[-3] = max(wide[-3], neck), max(deep[-3], neck)
    power = smooth_steps(at, [exponent] * 5 + [0.5 * exponent + 1, 2, 2], z)
    body = loft_sections(z, smooth_steps(at, wide, z), smooth_steps(at, deep, z), power)
    cap = screw_cap(draw, neck).translate((0, 0, height - 0.004))
    return union([body, cap])


def handle_bottle(draw: Draw) -> Manifold:
    """A bleach or detergent bottle: a flat body with a grip hole through one shoulder."""
    half_width = draw.uniform("half_width", 0.042, 0.075)
    half_depth = half_width * draw.uniform("depth_ratio", 0.45, 0.7)
    height = half_width * draw.uniform("height_ratio", 3.2, 4.6)
    neck = draw.uniform("neck_radius", 0.012, 0.02)
    exponent = draw.uniform("squareness", 2.4, 4.5)
    shift = draw.uniform("neck_shift", 0.0, 0.45) * half_width
    z = np.concatenate([[0, 0.002, 0.005], np.linspace(0.01, height, 30)])
    at = height * np.array([0, 0.01, 0.05, 0.55, 0.78, 0.9, 0.94, 1.0])
    wide = half_width * np.array([0.88, 0.95, 1, 1, 0.94, 0.6, 0, 0])
    deep = half_depth * np.array([0.85, 0.94, 1, 1, 0.9, 0.65, 0, 0])
    wide[-2:], deep[-2:] = neck, neck
    power = smooth_steps(at, [exponent] * 5 + [0.5 * exponent + 1, 2, 2], z)
    body = loft_sections(z, smooth_steps(at, wide, z), smooth_steps(at, deep, z), power)
    # Shearing the shoulder moves the neck away from the grip.
    levels = np.linspace(0, height, 50)
    lean = smooth_steps([0, 0.5 * height, 0.92 * height, height], [0, 0, -shift, -shift], levels)
    body = body.warp_batch(
        lambda p: p + np.column_stack([np.interp(p[:, 2], levels, lean), np.zeros((len(p), 2))])
    )
    # The hole follows the side at the depth of a grip, so that it never breaks out.
    grip, gap = draw.uniform("grip", 0.014, 0.02), draw.uniform("hole_width", 0.013, 0.02)
    start, span = 0.5 * height, height * draw.uniform("hole_length", 0.17, 0.26)
    rise = np.linspace(start, start + span, 8)
    side = smooth_steps(at, wide, rise) + np.interp(rise, levels, lean)
    path = np.column_stack([side - grip - gap / 2, np.zeros(8), rise])
    body -= tube(path, gap / 2, half_depth * 1.6, up=(0, 1, 0))
    return union([body, screw_cap(draw, neck).translate((-shift, 0, height - 0.004))])


def spray_bottle(draw: Draw) -> Manifold:
    """A trigger sprayer: bottle, neck, pistol head with a trigger and a nozzle."""
    half_width = draw.uniform("half_width", 0.03, 0.045)
    half_depth = half_width * draw.uniform("depth_ratio", 0.6, 1.0)
    height = half_width * draw.uniform("height_ratio", 3.2, 4.6)
    waist = draw.uniform("waist", 0.5, 0.9)
    neck = draw.uniform("neck_radius", 0.009, 0.014)
    z = np.concatenate([[0, 0.002, 0.005], np.linspace(0.01, height, 28)])
    at = height * np.array([0, 0.015, 0.06, 0.5, 0.72, 0.85, 0.93, 1.0])
    ratio = np.array([0.86, 0.95, 1, 1, 0.8 * waist + 0.2, waist, 0, 0])
    wide, deep = half_width * ratio, half_depth * ratio
    wide[-2:], deep[-2:] = neck, neck
    power = draw.uniform("squareness", 2.0, 4.0)
    body = loft_sections(z, smooth_steps(at, wide, z), smooth_steps(at, deep, z), power)
    head_length = draw.uniform("head_length", 0.06, 0.095)
    head_height = draw.uniform("head_height", 0.022, 0.034)
    head_width = draw.uniform("head_width", 0.018, 0.028)
    collar = cylinder(neck + 0.004, 0.022, 0.002).translate((0, 0, height - 0.01))
    head = rounded_box((head_length, head_width, head_height), 0.006)
    head = head.translate((0.18 * head_length, 0, height + 0.01))
    front = 0.68 * head_length
    nozzle = cylinder(0.008, 0.012, 0.0015, segments=20).rotate((0, 90, 0))
    nozzle = nozzle.translate((front - 0.003, 0, height + 0.01 + 0.65 * head_height))
    reach = draw.uniform("trigger_reach", 0.026, 0.042)
    pivot = (0.5 * head_length, 0, height + 0.016)
    middle = (0.46 * head_length, 0, height + 0.01 - 0.5 * reach)
    trigger = smooth_curve([pivot, middle, (0.6 * head_length, 0, height + 0.01 - reach)], 10)
    lever = tube(trigger, 0.003, draw.uniform("trigger_width", 0.004, 0.008), up=(0, 1, 0))
    return union([body, collar, head, nozzle, lever])


def pump_bottle(draw: Draw) -> Manifold:
    """A soap dispenser: a round or squarish bottle with a pump head and spout."""
    radius = draw.uniform("radius", 0.026, 0.042)
    height = radius * draw.uniform("height_ratio", 2.2, 4.2)
    neck = draw.uniform("neck_radius", 0.009, 0.014)
    z = np.concatenate([[0, 0.002], np.linspace(0.005, height, 24)])
    at = height * np.array([0, 0.02, 0.06, 0.75, 0.9, 1.0])
    shape = smooth_steps(at, np.array([0.9 * radius, 0.96 * radius, radius, radius, neck, neck]), z)
    deep = shape * draw.uniform("depth_ratio", 0.7, 1.0)
    body = loft_sections(z, shape, deep, draw.uniform("squareness", 2, 5))
    collar = cylinder(neck + 0.003, 0.018, 0.0015).translate((0, 0, height - 0.006))
    stem_height = draw.uniform("stem", 0.015, 0.035)
    stem = cylinder(0.0045, stem_height + 0.01, segments=16).translate((0, 0, height + 0.008))
    top = height + 0.012 + stem_height
    button = cylinder(draw.uniform("button", 0.009, 0.014), 0.012, 0.002)
    reach, drop = draw.uniform("spout", 0.025, 0.05), draw.uniform("drop", 0.0, 0.012)
    knots = [(0, 0, top + 0.001), (0.7 * reach, 0, top + 0.002), (reach, 0, top - drop)]
    nozzle = tube(smooth_curve(knots, 10), 0.0045, up=(0, 1, 0), corners=12)
    return union([body, collar, stem, button.translate((0, 0, top - 0.005)), nozzle])


def squeeze_tube(draw: Draw) -> Manifold:
    """A tube of toothpaste or cream: a round cap end that flattens to a crimped edge."""
    radius = draw.uniform("radius", 0.012, 0.026)
    length = radius * draw.uniform("length_ratio", 4.0, 8.0)
    crimp = draw.uniform("crimp", 0.0012, 0.003)
    z = np.concatenate([np.linspace(0, length - 0.008, 22), [length - 0.006, length]])
    flat = np.pi * radius / 2
    share = smooth_steps([0, 0.15 * length, length - 0.008, length], [0, 0.05, 1, 1], z)
    wide, deep = radius + (flat - radius) * share, radius + (crimp - radius) * share
    body = loft_sections(z, wide, deep, 2 + 0.6 * share)
    cap = screw_cap(draw, radius * draw.uniform("neck_ratio", 0.5, 0.95)).rotate((180, 0, 0))
    filled = union([body, cap.translate((0, 0, 0.003))])
    return filled if draw.chance("stands", 0.25) else filled.rotate((90, 0, 0))


def pitcher(draw: Draw) -> Manifold:
    """A jug with a handle and a spout: open and hollow, or closed by a lid and solid as a scan."""
    radius = draw.uniform("radius", 0.038, 0.068)
    height = radius * draw.uniform("height_ratio", 2.2, 3.8)
    wall = draw.uniform("wall", 0.002, 0.004)
    mouth = draw.uniform("mouth_ratio", 0.75, 1.1)
    belly = draw.uniform("belly_ratio", 0.95, 1.2)
    bulge = (belly * radius, 0.35 * height)
    neck = (0.5 * (belly + mouth) * radius, 0.75 * height)
    line = soften([(0, 0), (0.92 * radius, 0), bulge, neck, (mouth * radius, height)])
    spout, narrow = draw.uniform("spout", 0.08, 0.4), draw.uniform("spout_width", 0.25, 0.5)

    def pour(points: np.ndarray) -> np.ndarray:
        around = np.arctan2(points[:, 1], -points[:, 0])
        rise = np.clip((points[:, 2] / height - 0.6) / 0.4, 0, 1.2) ** 2
        push = 1 + spout * rise * np.exp(-((around / narrow) ** 2))
        return points * np.column_stack([push, push, np.ones_like(push)])

    fine = height / 10
    closed = draw.chance("closed", 0.5)
    vessel = solid_of(line, wall) if closed else shell(line, wall)
    body = refine(vessel, fine).warp_batch(pour)
    inside = refine(cavity(line, wall), fine).warp_batch(pour)
    thick = draw.uniform("handle_radius", 0.005, 0.009)
    low = height * draw.uniform("handle_low", 0.15, 0.3)
    high = height * draw.uniform("handle_high", 0.78, 0.92)
    reach = draw.uniform("handle_reach", 0.03, 0.05) + thick
    squareness = draw.uniform("handle_squareness", 0, 1)
    flat = draw.uniform("handle_flatness", 0.9, 1.7)
    handle = side_handle(line, low, high, reach, squareness, thick, thick * flat)
    jug = union([body, handle - inside])
    if closed:
        inner = mouth * radius - wall
        sunk = draw.uniform("lid_sunk", 0.0005, 0.01)
        jug -= cylinder(inner, 0.05, segments=48).translate((0, 0, height - sunk))
        if draw.chance("grip_bar", 0.6):
            bar = rounded_box((1.5 * inner, 0.012, 0.011 + sunk), 0.003)
            jug = union([jug, bar.translate((0, 0, height - sunk - 0.005))])
    return jug


FAMILIES = (
    Family("bottle", bottle, 3.0, "round", 0.003, 0),
    Family("squeeze_bottle", squeeze_bottle, 2.5, "solid", 0.004, 0),
    Family("handle_bottle", handle_bottle, 2.0, "compound", 0.004, 1),
    Family("spray_bottle", spray_bottle, 1.5, "compound", 0.004, 0),
    Family("pump_bottle", pump_bottle, 1.0, "compound", 0.003, 0),
    Family("squeeze_tube", squeeze_tube, 1.5, "solid", 0.01, 0),
    Family("pitcher", pitcher, 2.5, "vessel", 0.002, 1),
)
