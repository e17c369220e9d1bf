"""Solid packages and blocks: cartons, drink cartons, books, wood blocks, dice, sponges, remotes."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.refine import refine
from pointsdf_cli.objects.sections import grid, polygon, rounded, symmetric
from pointsdf_cli.objects.solids import bevelled, cylinder, ellipsoid, on_edge, rounded_box, union


def carton(draw: Draw) -> Manifold:
    """A cardboard box: three free edges, soft corners, its faces a little bulged or sunken."""
    long = draw.log_uniform("long", 0.06, 0.30)
    middle = long * draw.uniform("middle_ratio", 0.35, 1.0)
    short = middle * draw.uniform("short_ratio", 0.2, 0.95)
    radius = draw.log_uniform("edge_radius", 0.0005, 0.005)
    bulge = draw.uniform("bulge", -0.02, 0.05) * short
    size = np.array([middle, short, long])
    if draw.chance("lies", 0.35):
        size = size[[2, 0, 1]]
    box = refine(rounded_box(size, radius), long / 7)
    middle_point = np.array([0, 0, size[2] / 2])

    def bulged(points: np.ndarray) -> np.ndarray:
        unit = (points - middle_point) / (size / 2)
        dome = np.clip(1 - unit**2, 0, 1)
        others = np.stack([dome[:, [1, 2]], dome[:, [0, 2]], dome[:, [0, 1]]]).prod(axis=2).T
        return points + bulge * unit * others

    return box.warp_batch(bulged)


def drink_carton(draw: Draw) -> Manifold:
    """A drink carton with a flat, slanted or gabled top, perhaps with a screw cap or a straw."""
    width = draw.uniform("width", 0.045, 0.1)
    depth = width * draw.uniform("depth_ratio", 0.6, 1.0)
    height = width * draw.uniform("height_ratio", 1.2, 2.8)
    top = draw.choice("top", ("flat", "slanted", "gable"))
    radius = draw.uniform("edge_radius", 0.001, 0.004)
    body = rounded_box((width, depth, height), radius)
    parts = [body]
    if top == "slanted":
        rise = draw.uniform("slant", 0.15, 0.4) * depth
        half = depth / 2
        corners = [(-half, 0), (half, 0), (half, height), (-half, height + rise)]
        outline = rounded(polygon(corners), radius)
        # The outline stands in the (y, z) plane and is extruded along x.
        parts = [on_edge(bevelled(outline, width, radius), width)]
        height += rise / 2
    elif top == "gable":
        rise = draw.uniform("gable", 0.3, 0.55) * depth
        fin = draw.uniform("fin", 0.008, 0.018)
        half = depth / 2 - 0.001
        gable = symmetric([(half, 0), (half, height - 0.004), (0, height + rise)])
        parts.append(on_edge(gable.extrude(width - 0.002), width - 0.002))
        ridge = rounded_box((width - 0.002, 0.003, fin + rise), 0.001)
        parts.append(ridge.translate((0, 0, height)))
    if draw.chance("cap", 0.5):
        cap = cylinder(draw.uniform("cap_radius", 0.009, 0.015), 0.02, 0.0015)
        if top == "gable":
            slope = np.degrees(np.arctan2(rise, depth / 2))
            cap = cap.translate((0, 0, -0.006)).rotate((float(slope), 0, 0))
            parts.append(cap.translate((0, -depth / 4, height + rise / 2)))
        else:
            offset = draw.uniform("cap_offset", -0.15, 0.15) * depth
            parts.append(cap.translate((0, offset, height - 0.008)))
    return union(parts)


def book(draw: Draw) -> Manifold:
    """A closed book lying down: two boards and a spine that overhang the block of pages."""
    length = draw.uniform("length", 0.12, 0.28)
    width = length * draw.uniform("width_ratio", 0.6, 0.85)
    thickness = draw.uniform("thickness", 0.01, 0.05)
    board = draw.uniform("board", 0.0012, 0.003)
    overhang = draw.uniform("overhang", 0.0015, 0.005)
    pages = rounded_box((width - overhang, length - 2 * overhang, thickness - board))
    lower = rounded_box((width, length, board), 0.0005)
    spine = rounded_box((2 * board, length, thickness), 0.4 * board)
    upper = lower.translate((0, 0, thickness - board))
    pages = pages.translate((-overhang / 2, 0, board / 2))
    return union([pages, lower, upper, spine.translate((-width / 2 + board, 0, 0))])


def wood_block(draw: Draw) -> Manifold:
    """A toy building block: cuboid, prism, half round, arch or cross."""
    forms = ("cuboid", "cuboid", "cube", "prism", "half_round", "cross", "column")
    form = draw.choice("form", forms)
    edge = draw.log_uniform("edge", 0.03, 0.1)
    radius = draw.uniform("edge_radius", 0.0005, 0.004)
    depth = edge * draw.uniform("depth_ratio", 0.4, 1.0)
    if form == "cube":
        return rounded_box((edge, edge, edge), radius)
    if form == "cuboid":
        return rounded_box((edge, depth, edge * draw.uniform("height_ratio", 0.5, 3.0)), radius)
    if form == "column":
        sides = draw.choice("sides", (3, 6, 8, 40))
        round_section = CrossSection.circle(edge / 2, sides)
        return bevelled(round_section, edge * draw.uniform("height_ratio", 0.5, 2.5), radius)
    if form == "prism":
        lean = draw.uniform("lean", -0.5, 0.5) * edge
        outline = [(-edge / 2, 0), (edge / 2, 0), (lean, edge * draw.uniform("rise", 0.4, 0.9))]
        return on_edge(bevelled(rounded(polygon(outline), radius), depth, radius), depth)
    if form == "half_round":
        upper = CrossSection.square((edge, edge)).translate((-edge / 2, 0))
        disc = CrossSection.circle(edge / 2, 48) ^ upper
        return on_edge(bevelled(rounded(disc, radius), depth, radius), depth)
    bar = CrossSection.square((edge, edge * draw.uniform("bar", 0.25, 0.5)), True)
    return bevelled(rounded(bar + bar.rotate(90), radius), depth, radius)


def die(draw: Draw) -> Manifold:
    """A die: a cube with corners cut by a sphere and pips drilled into each face."""
    edge = draw.uniform("edge", 0.03, 0.055)
    roundness = draw.uniform("roundness", 0.66, 0.82)
    cube = rounded_box((edge, edge, edge), 0.04 * edge).translate((0, 0, -edge / 2))
    cube = cube ^ Manifold.sphere(edge * roundness, 56)
    pip = draw.uniform("pip", 0.07, 0.1) * edge
    drill = Manifold.sphere(pip, 12).translate((0, 0, edge / 2 + 0.35 * pip))
    spread = 0.26 * edge
    turns = ((0, 0, 0), (180, 0, 0), (90, 0, 0), (-90, 0, 0), (0, 90, 0), (0, -90, 0))
    corners = [(-1, -1), (1, 1), (-1, 1), (1, -1), (-1, 0), (1, 0)]
    faces = {1: [(0, 0)], 2: corners[:2], 3: [(0, 0), *corners[:2]], 4: corners[:4]}
    faces |= {5: [(0, 0), *corners[:4]], 6: corners}
    holes = [
        drill.translate((spread * x, spread * y, 0)).rotate(turn)
        for turn, number in zip(turns, (1, 6, 2, 5, 3, 4), strict=True)
        for x, y in faces[number]
    ]
    return cube - union(holes)


def sponge(draw: Draw) -> Manifold:
    """A soft pad with rounded, sagging edges: thinner towards the rim, or waisted."""
    length = draw.uniform("length", 0.07, 0.15)
    width = length * draw.uniform("width_ratio", 0.55, 0.9)
    thickness = draw.uniform("thickness", 0.015, 0.045)
    sag = draw.uniform("sag", 0.0, 0.4)
    waist = draw.uniform("waist", -0.05, 0.2)
    corner = draw.uniform("corner", 0.002, 0.012)
    pad = refine(rounded_box((width, length, thickness), min(corner, thickness / 3)), 0.012)

    def soften(points: np.ndarray) -> np.ndarray:
        u, v = points[:, 0] / (width / 2), points[:, 1] / (length / 2)
        rim = np.clip(np.maximum(np.abs(u), np.abs(v)), 0, 1) ** 4
        z = (points[:, 2] - thickness / 2) * (1 - sag * rim)
        return np.column_stack([points[:, 0] * (1 - waist * (1 - v**2)), points[:, 1], z])

    return pad.warp_batch(soften)


def soap(draw: Draw) -> Manifold:
    """A bar between an ellipsoid and a box, as soap, pebbles and computer mice are."""
    length = draw.uniform("length", 0.05, 0.13)
    width = length * draw.uniform("width_ratio", 0.5, 0.8)
    height = width * draw.uniform("height_ratio", 0.35, 0.8)
    power = draw.uniform("power", 0.45, 0.95)

    def inflate(points: np.ndarray) -> np.ndarray:
        shaped = np.sign(points) * np.abs(points) ** power
        return shaped * np.array([length, width, height]) / 2

    bar = Manifold.sphere(1.0, 72).warp_batch(inflate)
    if draw.chance("flat_bottom", 0.5):
        bar = bar.trim_by_plane((0, 0, 1), -height * draw.uniform("cut", 0.1, 0.4))
    return bar


def remote(draw: Draw) -> Manifold:
    """A remote control or telephone: a tapered slab with rows of buttons."""
    length = draw.uniform("length", 0.1, 0.22)
    width = length * draw.uniform("width_ratio", 0.2, 0.42)
    thickness = draw.uniform("thickness", 0.009, 0.026)
    taper = draw.uniform("taper", 0.75, 1.1)
    corner = draw.uniform("corner", 0.1, 0.45) * width
    outline = symmetric([(width / 2 * taper, -length / 2), (width / 2, length / 2)])
    body = bevelled(rounded(outline, min(corner, 0.4 * width * min(taper, 1))), thickness, 0.004)
    columns = draw.integer("button_columns", 0, 3)
    rows = draw.integer("button_rows", 3, 8)
    rise = draw.uniform("button_rise", 0.0008, 0.002)
    if columns == 0:
        return body
    pitch = min(0.7 * width * min(taper, 1) / columns, 0.75 * length / rows)
    button = ellipsoid((0.38 * pitch, 0.32 * pitch, 1.9 * rise), segments=12)
    buttons = [button.translate((x, y, thickness - rise)) for x, y in grid(columns, rows, pitch)]
    return union([body, *buttons])


FAMILIES = (
    Family("carton", carton, 6.0, "solid", 0.01, 0),
    Family("drink_carton", drink_carton, 2.0, "solid", 0.006, 0),
    Family("book", book, 1.0, "solid", 0.004, 0),
    Family("wood_block", wood_block, 2.5, "solid", 0.003, 0),
    Family("die", die, 1.0, "solid", 0.004, 0),
    Family("sponge", sponge, 1.5, "solid", 0.02, 0),
    Family("soap", soap, 1.5, "solid", 0.01, 0),
    Family("remote", remote, 1.5, "flat", 0.004, 0),
)
