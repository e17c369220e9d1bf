"""Building blocks: studded bricks, built bricks, arches, peg boards."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from pointsdf_cli.objects.family import Draw, Family
from pointsdf_cli.objects.sections import grid, polygon, rounded, symmetric
from pointsdf_cli.objects.solids import bevelled, centred, cylinder, on_edge, rounded_box, union


def brick(draw: Draw) -> Manifold:
    """A studded building brick: block, curved or sloped; hollow below as moulded, or filled."""
    pitch = draw.uniform("pitch", 0.013, 0.024)
    columns, rows = draw.integer("columns", 1, 2), draw.integer("rows", 2, 5)
    height = pitch * draw.choice("height_units", (0.6, 1.2, 1.2, 2.4))
    form = draw.choice("form", ("block", "block", "curved", "sloped"))
    wall = draw.uniform("wall", 0.0014, 0.0035)
    gap = 0.0003
    width, length = columns * pitch - gap, rows * pitch - gap
    half = length / 2
    if form == "curved" and rows >= 3:
        flat = half - pitch
        t = np.linspace(0, np.pi / 2, 9)
        y, z = flat + (half - flat) * np.cos(t), height * (0.15 + 0.85 * np.sin(t))
        outline = symmetric([(half, 0), *np.column_stack([y, z])])
        studs = grid(columns, max(rows - 2, 1), pitch)
        body = on_edge(bevelled(outline, width, 0.0006), width)
    elif form == "sloped" and rows >= 3:
        slope = [(half, 0.15 * height), (half - 1.1 * pitch, height)]
        outline = rounded(polygon([(-half, 0), (half, 0), *slope, (-half, height)]), 0.0005)
        body = on_edge(bevelled(outline, width, 0.0006), width)
        studs = [(x, y - pitch / 2) for x, y in grid(columns, rows - 1, pitch)]
    else:
        body = rounded_box((width, length, height), 0.0007)
        studs = grid(columns, rows, pitch)
    stud = pitch * draw.uniform("stud_ratio", 0.27, 0.33)
    rise = pitch * draw.uniform("stud_rise", 0.18, 0.3)
    knob = cylinder(stud, rise + 0.002, 0.0006, segments=24)
    if draw.chance("hollow_studs", 0.6):
        knob -= cylinder(0.62 * stud, rise, segments=20).translate((0, 0, 0.003))
    parts = [body, *(knob.translate((x, y, height - 0.002)) for x, y in studs)]
    filled = union(parts)
    if not draw.chance("hollow_below", 0.6):
        return filled
    roof, inset = height - wall, wall
    if form != "block" and rows >= 3:
        # The room below keeps clear of a slope or a curve by being as high as their lowest edge.
        roof, inset = max(0.15 * height, 0.55 * height - wall), max(wall, 0.45 * pitch)
    room = rounded_box((width - 2 * wall, length - 2 * inset, roof + 0.005))
    room = room.translate((0, 0, -0.005))
    if columns > 1 and rows > 1:
        bore = cylinder(0.3 * pitch, roof - 0.001, segments=20).translate((0, 0, -1e-3))
        pipe = cylinder(0.4 * pitch, roof + 0.001, segments=24) - bore
        room -= union([pipe.translate((x, y, 0)) for x, y in grid(columns - 1, rows - 1, pitch)])
    return filled - room


def brick_stack(draw: Draw) -> Manifold:
    """Several bricks built into one piece: stairs, towers, bridges with an arch."""
    pitch = draw.uniform("pitch", 0.013, 0.02)
    layers = draw.integer("layers", 2, 4)
    height = 1.2 * pitch
    parts = []
    for layer in range(layers):
        long = int(draw.rng.integers(2, 5))
        shift = pitch * int(draw.rng.integers(-1, 2)) if layer else 0.0
        turned = layer > 0 and draw.rng.random() < 0.3
        # A thousandth wider per layer, so that no two side faces lie in one plane.
        grow = 1 - 0.001 * layer
        block = rounded_box((2 * pitch * grow, long * pitch * grow, height + 1e-4), 0.0006)
        stud = cylinder(0.3 * pitch, 0.25 * pitch, 0.0006, segments=20)
        studs = [stud.translate((x, y, height - 0.001)) for x, y in grid(2, long, pitch)]
        piece = union([block, *studs])
        piece = piece.rotate((0, 0, 90)) if turned else piece
        parts.append(piece.translate((0, shift, layer * height - 1e-4 * layer)))
    solid = union(parts)
    if draw.chance("arch", 0.4):
        gate = centred(cylinder(0.6 * pitch, 6 * pitch, segments=32), 6 * pitch, (0, 90, 0))
        solid -= gate.translate((0, 0, 0.1 * pitch))
    return solid


def arch_block(draw: Draw) -> Manifold:
    """A wooden arch, bridge or gate: a block with one or two round or square openings below."""
    width = draw.uniform("width", 0.06, 0.16)
    height = width * draw.uniform("height_ratio", 0.4, 0.9)
    depth = width * draw.uniform("depth_ratio", 0.2, 0.6)
    openings = draw.integer("openings", 1, 2)
    outline = CrossSection.square((width, height)).translate((-width / 2, 0))
    room = width / openings
    radius = room * draw.uniform("opening_ratio", 0.2, 0.38)
    spring = max(0.0, min(height - radius - 0.012, height * draw.uniform("spring", 0.0, 0.5)))
    radius = min(radius, height - spring - 0.008)
    for index in range(openings):
        centre = room * (index - (openings - 1) / 2)
        hole = CrossSection.circle(radius, 40).translate((centre, spring))
        hole += CrossSection.square((2 * radius, spring + 0.05)).translate((centre - radius, -0.05))
        outline -= hole
    plate = bevelled(rounded(outline, 0.0012), depth, draw.uniform("edge", 0.0004, 0.003))
    return on_edge(plate, depth)


def peg_board(draw: Draw) -> Manifold:
    """A board with rows of blind holes, some holding pegs: peg tests, pen stands, egg trays."""
    columns, rows = draw.integer("columns", 2, 5), draw.integer("rows", 2, 5)
    pitch = draw.uniform("pitch", 0.018, 0.045)
    thickness = draw.uniform("thickness", 0.012, 0.04)
    hole = pitch * draw.uniform("hole_ratio", 0.1, 0.36)
    margin = draw.uniform("margin", 0.002, 0.02)
    size = (columns * pitch + margin, rows * pitch + margin, thickness)
    board = rounded_box(size, draw.uniform("edge", 0.0005, 0.004))
    floor = thickness * draw.uniform("floor", 0.12, 0.6)
    drill = cylinder(hole, thickness, segments=20).translate((0, 0, floor))
    places = grid(columns, rows, pitch)
    board -= union([drill.translate((x, y, 0)) for x, y in places])
    share = draw.uniform("peg_share", 0.0, 0.7)
    length = thickness * draw.uniform("peg_length", 0.8, 2.2)
    peg = cylinder(hole * 1.02, length, 0.0006, segments=20).translate((0, 0, floor - 0.001))
    pegs = [peg.translate((x, y, 0)) for x, y in places if draw.rng.random() < share]
    return union([board, *pegs])


FAMILIES = (
    Family("brick", brick, 3.0, "toy", 0.002, 0),
    Family("brick_stack", brick_stack, 1.5, "toy", 0.002),
    Family("arch_block", arch_block, 1.0, "toy", 0.003, 0),
    Family("peg_board", peg_board, 2.0, "toy", 0.003, 0),
)
