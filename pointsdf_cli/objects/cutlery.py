"""Cutlery and kitchen tools, lying on the table: forks, spoons, knives, spatulas, ladles."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.refine import refine
from pointsdf_cli.objects.sections import (
    polygon,
    rounded,
    smooth_curve,
    smooth_steps,
    stroke,
    symmetric,
)
from pointsdf_cli.objects.solids import bevelled, cylinder, ellipsoid, tube, union

# Edge and back of a blade at five places along it, as fractions of its width.
_BLADES: dict[str, tuple[list[float], list[float]]] = {
    "pointed": ([0, 0, 0.05, 0.35, 1], [1, 1, 1, 1, 1]),
    "round": ([0, 0, 0, 0.12, 0.6], [1, 1, 1, 0.95, 0.7]),
    "cleaver": ([0, 0, 0, 0, 0.05], [1, 1, 1, 1, 1]),
    "dagger": ([0, 0, 0.1, 0.25, 0.5], [1, 1, 0.9, 0.75, 0.5]),
}


def _handle(draw: Draw, length: float) -> Manifold:
    """A handle from y = −length to y = 0: flat metal, or thick as of plastic."""
    thick = draw.chance("thick_handle", 0.45)
    end = draw.uniform("handle_width", 0.005, 0.009)
    neck = draw.uniform("neck_width", 0.0026, 0.0045)
    t = np.linspace(0, 1, 18)
    wide = smooth_steps([0, 0.08, 0.45, 0.75, 1], [0.8 * end, end, 0.8 * end, neck, neck], t)
    if thick:
        bulk = end * draw.uniform("handle_bulk", 0.7, 1.2)
        heights = [0.7 * bulk, bulk, 0.85 * bulk, 0.0016, 0.0013]
        high = smooth_steps([0, 0.1, 0.6, 0.75, 1], heights, t)
    else:
        high = np.full_like(t, draw.uniform("handle_sheet", 0.0009, 0.0018))
    arch = draw.uniform("handle_arch", 0.0, 0.012)
    path = np.column_stack([np.zeros_like(t), length * (t - 1), arch * np.sin(np.pi * t)])
    return tube(path, wide, high, exponent=2.6, corners=14)


def _bent(plate: Manifold, depth: float, length: float) -> Manifold:
    """Bend a plate that starts at y = 0 so that it sags by `depth` in the middle of its length."""

    def sag(points: np.ndarray) -> np.ndarray:
        along = np.clip(points[:, 1] / length, 0, 1)
        drop = depth * (np.sin(np.pi * along) - 0.4 * along)
        return points - np.column_stack([np.zeros((len(points), 2)), drop])

    return plate.warp_batch(sag)


def fork(draw: Draw) -> Manifold:
    """A table fork or garden fork: handle, shoulder and two to five tines."""
    length = draw.uniform("handle_length", 0.11, 0.16)
    tines = draw.integer("tines", 2, 5)
    width = draw.uniform("head_width", 0.018, 0.03)
    tine_length = draw.uniform("tine_length", 0.03, 0.055)
    root = draw.uniform("root_length", 0.018, 0.032)
    sheet = draw.uniform("sheet", 0.0018, 0.0032)
    fill = draw.uniform("tine_fill", 0.4, 0.62)
    pitch = width / tines
    place = pitch * (np.arange(tines) - (tines - 1) / 2)
    outline = symmetric([(0.003, -0.004), (0.42 * width, 0.6 * root), (0.5 * width, root + 0.002)])
    y, thick = root + np.linspace(0, tine_length, 5), pitch * np.linspace(fill, 0.6 * fill, 5)
    for x in place:
        outline += stroke(np.column_stack([np.full(5, x), y]), thick)
    outline = rounded(outline, 0.0, 0.15 * pitch)
    head = bevelled(outline, sheet, 0.25 * sheet).translate((0, 0, -sheet / 2))
    handle, sag = _handle(draw, length), draw.uniform("sag", 0.0, 0.012)
    return union([handle, _bent(refine(head, 0.006), sag, root + tine_length)])


def spoon(draw: Draw) -> Manifold:
    """A spoon, from tea spoon to serving spoon: a thin dished oval on a handle."""
    length = draw.uniform("handle_length", 0.08, 0.19)
    long = draw.uniform("bowl_half_length", 0.016, 0.036)
    wide = long * draw.uniform("bowl_ratio", 0.58, 0.95)
    depth = wide * draw.uniform("depth_ratio", 0.3, 0.75)
    sheet = draw.uniform("sheet", 0.0014, 0.003)
    outer = ellipsoid((wide, long, depth), segments=48)
    inner = ellipsoid((wide - 0.6 * sheet, long - 0.6 * sheet, depth - sheet), segments=48)
    dish = (outer - inner).trim_by_plane((0, 0, -1), 0.0).translate((0, 0.94 * long, 0.0))
    handle = _handle(draw, length)
    keep_clear = inner.translate((0, 0.94 * long, 0))
    return union([dish, (handle.translate((0, 0.006, -0.0004)) - keep_clear)])


def ladle(draw: Draw) -> Manifold:
    """A ladle, scoop or measuring spoon: a deep thin cup with an upright or level handle."""
    radius = draw.uniform("radius", 0.02, 0.045)
    wall = draw.uniform("wall", 0.0014, 0.003)
    cut = draw.uniform("cut", -0.1, 0.35) * radius
    outer, inner = Manifold.sphere(radius, 48), Manifold.sphere(radius - wall, 48)
    cup = (outer - inner).trim_by_plane((0, 0, -1), -cut)
    rim = float(np.sqrt(radius**2 - cut**2)) - wall / 2
    length = draw.uniform("handle_length", 0.08, 0.22)
    lift = draw.uniform("lift", 0.0, 1.1)
    thick = draw.uniform("handle_radius", 0.003, 0.006)
    ends = np.array([np.cos(lift), 0, np.sin(lift)]) * length
    start = np.array([rim, 0, cut - 0.004])
    middle = start + 0.45 * ends + [0.1 * radius, 0, -0.1 * radius]
    path = smooth_curve([start, middle, start + ends], 14)
    handle = tube(path, thick, 0.6 * thick, up=(0, 1, 0), round_ends=True)
    return union([cup, handle - inner])


def knife(draw: Draw) -> Manifold:
    """A table, kitchen or palette knife: a tapered blade with a back and an edge."""
    blade = draw.uniform("blade_length", 0.07, 0.19)
    width = draw.uniform("blade_width", 0.014, 0.042)
    back = draw.uniform("back", 0.0012, 0.0035)
    form = draw.choice("form", tuple(_BLADES))
    t = np.linspace(0, 1, 16)
    low, high = _BLADES[form]
    at = [0, 0.3, 0.6, 0.85, 1]
    spine = width * smooth_steps(at, high, t)
    edge = np.minimum(width * smooth_steps(at, low, t), spine - 0.0015)
    sides = [np.column_stack([x, blade * t]) for x in (edge, spine)]
    outline = polygon(np.concatenate([sides[0], sides[1][::-1]]))
    plate = bevelled(rounded(outline, 0.0004), back).translate((-0.62 * width, 0, -back / 2))

    def sharpen(points: np.ndarray) -> np.ndarray:
        across = np.clip((points[:, 0] + 0.62 * width) / width, 0.0, 1.0)
        thin = 0.3 + 0.7 * np.clip(across / 0.6, 0, 1)
        return points * np.column_stack([np.ones((len(points), 2)), thin])

    plate = refine(plate, 0.012).warp_batch(sharpen)
    grip = draw.uniform("grip_width", 0.007, 0.014)
    bulk = grip * draw.uniform("grip_bulk", 0.45, 1.0)
    length = draw.uniform("grip_length", 0.08, 0.125)
    s = np.linspace(0, 1, 16)
    shape = smooth_steps([0, 0.15, 0.5, 0.85, 1], [0.85, 1.0, 0.82, 0.95, 0.6], s)
    path = np.column_stack([np.zeros_like(s), 0.012 - length * (1 - s), np.zeros_like(s)])
    return union([plate, tube(path, grip * shape, bulk * shape, exponent=2.8)])


def spatula(draw: Draw) -> Manifold:
    """A turner, scraper or rubber spatula: a thin, often slotted blade on a cranked handle."""
    blade = draw.uniform("blade_length", 0.06, 0.11)
    width = draw.uniform("blade_width", 0.035, 0.085)
    taper = draw.uniform("taper", 0.6, 1.0)
    sheet = draw.uniform("sheet", 0.0012, 0.0045)
    handle = draw.uniform("handle_length", 0.12, 0.23)
    crank = draw.uniform("crank", 0.0, 0.045)
    thick = draw.uniform("grip_radius", 0.005, 0.011)
    outline = symmetric([(width / 2 * taper, 0), (width / 2, blade)])
    outline = rounded(outline, draw.uniform("corner", 0.003, 0.014))
    slots = draw.integer("slots", 0, 5)
    if slots:
        pitch = 0.8 * width * taper / slots
        for index in range(slots):
            x = pitch * (index - (slots - 1) / 2)
            outline -= stroke([(x, 0.25 * blade), (x, 0.8 * blade)], 0.45 * pitch)
    plate = bevelled(outline, sheet, 0.3 * sheet)
    t = np.linspace(0, 1, 20)
    shank = [(0, 0.012, 0.6 * sheet), (0, -0.012, 0.004 + 0.25 * crank)]
    grip = [(0, -0.35 * handle, 0.7 * crank), (0, -handle, crank)]
    slim = draw.uniform("neck_ratio", 0.35, 0.8)
    wide = thick * smooth_steps([0, 0.35, 0.55, 0.9, 1], [slim, slim, 1, 1, 0.75], t)
    path = smooth_curve([*shank, *grip], 20)
    return union([plate, tube(path, wide, np.maximum(0.6 * wide, 0.0018))])


def rolling_pin(draw: Draw) -> Manifold:
    """A roller with two grips, lying: rolling pins, dumb-bells, bobbins, bolts."""
    radius = draw.uniform("radius", 0.012, 0.035)
    length = draw.uniform("length", 0.05, 0.22)
    grip = radius * draw.uniform("grip_ratio", 0.3, 0.7)
    tail = draw.uniform("grip_length", 0.02, 0.06)
    if draw.chance("dumb_bell", 0.4):
        corners = draw.choice("corners", (6, 8, 36))
        weight = bevelled(CrossSection.circle(radius, corners), 0.3 * length, 0.1 * radius)
        parts = [weight, weight.translate((0, 0, length - 0.3 * length))]
        parts.append(cylinder(grip, 0.8 * length, segments=28).translate((0, 0, 0.1 * length)))
    else:
        parts = [cylinder(radius, length, 0.15 * radius)]
        knob = ellipsoid((grip, grip, tail), segments=28)
        parts += [knob.translate((0, 0, -0.4 * tail)), knob.translate((0, 0, length + 0.4 * tail))]
    pin = union(parts)
    if draw.chance("socket", 0.3):
        deep = draw.uniform("socket_depth", 0.15, 0.5) * length
        socket = CrossSection.circle(0.6 * radius, 6).extrude(2 * deep)
        pin -= socket.translate((0, 0, length - deep))
    return pin.rotate((0, 90, 0))


FAMILIES = (
    Family("fork", fork, 2.0, "flat", 0.002, 0),
    Family("spoon", spoon, 2.0, "flat", 0.002, 0),
    Family("ladle", ladle, 1.0, "vessel", 0.002, 0),
    Family("knife", knife, 2.0, "flat", 0.002, 0),
    Family("spatula", spatula, 2.0, "flat", 0.002),
    Family("rolling_pin", rolling_pin, 1.0, "tool", 0.003, 0),
)
