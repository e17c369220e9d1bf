"""Solids to build objects from: turned, bevelled, lofted and swept bodies on manifold3d.

Every function returns a closed manifold in metres; unions and differences of them stay closed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from manifold3d import CrossSection, Manifold, Mesh, OpType, triangulate

from pointsdf_cli.objects.sections import Points, Vector, polygon, rounded, signed_area

# Segments of a full turn: an 8 cm can then deviates from its circle by 0.1 mm.
TURN_SEGMENTS = 48

Extent = float | tuple[float, float] | np.ndarray
"""Half an extent along a path of M points, m: a number, its values at both ends, or [M]."""


def union(parts: Sequence[Manifold]) -> Manifold:
    """All parts as one solid, overlaps removed."""
    return Manifold.batch_boolean(list(parts), OpType.Add)


def turn(
    profile: Points | CrossSection, fillet: float = 0.0, segments: int = TURN_SEGMENTS
) -> Manifold:
    """Revolve a profile about z.

    Args:
        profile: [N, 2] (radius, z) from the bottom to the top, whose ends are joined level to the
            axis, or a region of the (radius, z) half plane.
        fillet: Radius that all its corners are rounded by, m.
        segments: Corners of a full turn.
    """
    if isinstance(profile, CrossSection):
        half = profile
    else:
        half = polygon([(0, profile[0][1]), *profile, (0, profile[-1][1])])
    if fillet > 0:
        # Mirrored first, so that the rounding does not touch the axis.
        half = rounded(half + half.mirror((1.0, 0.0)), fillet)
    # Clipped here: `revolve` leaves doubled points on the axis where it does the clipping.
    right_half_plane = CrossSection.square((2.0, 4.0)).translate((0.0, -2.0))
    return (half ^ right_half_plane).revolve(segments)


def cylinder(radius: float, height: float, fillet: float = 0.0, segments: int = 0) -> Manifold:
    """An upright cylinder from z = 0 to `height`, its rims rounded by `fillet`."""
    fillet = min(fillet, 0.49 * radius, 0.49 * height)
    return turn([(radius, 0), (radius, height)], fillet, segments or 40)


def rounded_box(size: Vector, radius: float = 0.0, segments: int = 12) -> Manifold:
    """A box [-x/2, x/2] × [-y/2, y/2] × [0, z] with rounded edges."""
    extent = np.asarray(size, dtype=float)
    radius = min(radius, 0.49 * float(extent.min()))
    if radius <= 1e-5:
        return Manifold.cube(tuple(extent), True).translate((0, 0, extent[2] / 2))
    corner = Manifold.sphere(radius, segments)
    inner = extent / 2 - radius
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    centres = signs * inner + [0, 0, extent[2] / 2]
    return Manifold.batch_hull([corner.translate(tuple(centre)) for centre in centres])


def ellipsoid(radii: Vector, centre: Vector = (0, 0, 0), segments: int = 32) -> Manifold:
    """An axis-aligned ellipsoid."""
    return Manifold.sphere(1.0, segments).scale(tuple(radii)).translate(tuple(centre))


def star_solid(radius: Callable[[np.ndarray], np.ndarray], segments: int = 48) -> Manifold:
    """Body with its surface at `radius(direction)` from the origin.

    Args:
        radius: Maps unit vectors [N, 3] to distances [N] in metres.
        segments: Fineness of the sphere that is displaced (`segments`² triangles in all).
    """

    def displace(points: np.ndarray) -> np.ndarray:
        direction = points / np.linalg.norm(points, axis=1, keepdims=True)
        return direction * radius(direction)[:, None]

    return Manifold.sphere(1.0, segments).warp_batch(displace)


def loft(rings: np.ndarray, closed: bool = False) -> Manifold:
    """Join rings [L, N, 3] of points into a body, the last to the first or each end to its centre.

    The rings run counter-clockwise seen against the direction in which they are stacked. End rings
    must be star-shaped about their mean.
    """
    levels, count, _ = rings.shape
    index = np.arange(levels * count).reshape(levels, count)
    following = np.roll(index, -1, axis=1)
    if closed:
        around = [*range(levels), 0]
        return _solid(rings.reshape(-1, 3), _sides(index[around], following[around]))
    bottom, top = levels * count, levels * count + 1
    fan_low = np.stack([following[0], index[0], np.full(count, bottom)], -1)
    fan_high = np.stack([index[-1], following[-1], np.full(count, top)], -1)
    vertices = np.concatenate([rings.reshape(-1, 3), [rings[0].mean(0)], [rings[-1].mean(0)]])
    return _solid(vertices, np.concatenate([_sides(index, following), fan_low, fan_high]))


def loft_sections(
    z: np.ndarray,
    half_x: np.ndarray,
    half_y: np.ndarray,
    exponent: float | np.ndarray = 2.0,
    corners: int = TURN_SEGMENTS,
) -> Manifold:
    """A body of superellipse sections |x/a|ⁿ + |y/b|ⁿ = 1 stacked along z.

    Args:
        z: [L] rising heights, m.
        half_x: a, [L] m.
        half_y: b, [L] m.
        exponent: n, 2 for ellipses, larger for boxier sections; a number or [L].
        corners: Points a section.
    """
    x, y = _superellipse(np.broadcast_to(exponent, z.shape)[:, None], corners)
    heights = np.broadcast_to(z[:, None], x.shape)
    return loft(np.stack([half_x[:, None] * x, half_y[:, None] * y, heights], axis=-1))


def tube(
    path: np.ndarray,
    half_width: Extent,
    half_height: Extent | None = None,
    up: Vector = (0.0, 0.0, 1.0),
    corners: int = 16,
    exponent: float = 2.0,
    closed: bool = False,
    round_ends: bool = True,
) -> Manifold:
    """Sweep a superellipse along a path.

    Args:
        path: [M, 3] m, nowhere parallel to `up`, curved less tightly than the section is wide.
        half_width: Half the section across `up`.
        half_height: Half the section along `up`; as wide as high when None.
        up: The direction the section keeps upright.
        corners: Points of the section.
        exponent: 2 for ellipses, larger for boxier sections.
        closed: Whether the last point joins the first.
        round_ends: Whether open ends are domed instead of cut flat.
    """
    count = len(path)
    width = _along(half_width, count)
    height = width if half_height is None else _along(half_height, count)
    if closed:
        tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    else:
        tangent = np.gradient(path, axis=0)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    if round_ends and not closed:
        path, width, height, tangent = _dome_ends(path, width, height, tangent)
    side = np.cross(tangent, np.asarray(up, dtype=float))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    rise = np.cross(side, tangent)
    cosine, sine = _superellipse(exponent, corners)
    across = (width[:, None] * cosine)[..., None] * side[:, None]
    # side × rise = −tangent, so the angle runs backwards to keep the rings counter-clockwise.
    along = (-height[:, None] * sine)[..., None] * rise[:, None]
    return loft(path[:, None] + across + along, closed)


def bevelled(section: CrossSection, thickness: float, bevel: float = 0.0) -> Manifold:
    """A plate of the given outline from z = 0 to `thickness`, its edges rounded by `bevel`.

    The outline may have holes. Where it is too narrow for the bevel the plate is cut square.
    """
    outlines = [np.asarray(outline) for outline in section.to_polygons()]
    bevel = min(bevel, 0.45 * thickness)
    # A quarter circle in three steps: (inset, rise) in units of the bevel.
    steps = [(1.0, 0.0), (0.293, 0.293), (0.0, 1.0)] if bevel > 0 else [(0.0, 0.0)]
    while True:
        insets = [[_inset(outline, amount * bevel) for outline in outlines] for amount, _ in steps]
        if bevel <= 0 or all(_same_turns(outlines, inset) for inset in insets):
            break
        bevel = 0.5 * bevel if bevel > 1e-4 else 0.0
        steps = steps if bevel > 0 else [(0.0, 0.0)]
    rises = [rise * bevel for _, rise in steps]
    heights = rises + [thickness - rise for rise in reversed(rises)]
    layers = np.stack([np.concatenate(inset) for inset in insets + insets[::-1]])
    index = np.arange(layers[..., 0].size).reshape(len(layers), -1)
    vertices = np.column_stack([layers.reshape(-1, 2), np.repeat(heights, index.shape[1])])
    ends = np.cumsum([len(outline) for outline in outlines])
    following = [np.roll(part, -1, axis=1) for part in np.split(index, ends, axis=1)]
    cap = np.asarray(triangulate(insets[0]))
    sides = _sides(index, np.concatenate(following, axis=1))
    solid = _solid(vertices, np.concatenate([cap[:, ::-1], cap + index[-1, 0], sides]))
    return solid if solid.volume() > 0 else section.extrude(thickness)


def on_edge(plate: Manifold, thickness: float) -> Manifold:
    """Stand a plate drawn in (x, y) up: its x along y, its y along z, centred in depth on x = 0."""
    return centred(plate, thickness, (90, 0, 0)).rotate((0, 0, 90))


def centred(solid: Manifold, height: float, turn_by: Vector = (0, 0, 0)) -> Manifold:
    """Lower a solid that stands `height` m high on z = 0 by half of that, then rotate it [°]."""
    return solid.translate((0, 0, -height / 2)).rotate(tuple(turn_by))


def _solid(vertices: np.ndarray, faces: np.ndarray) -> Manifold:
    return Manifold(Mesh(vertices.astype(np.float32), faces.astype(np.uint32)))


def _sides(index: np.ndarray, following: np.ndarray) -> np.ndarray:
    """Faces [F, 3] between rings of vertices [L, N]; `following` [L, N] is the next one of each."""
    low, low_next, high, high_next = index[:-1], following[:-1], index[1:], following[1:]
    halves = [np.stack([low, low_next, high_next], -1), np.stack([low, high_next, high], -1)]
    return np.concatenate(halves).reshape(-1, 3)


def _superellipse(exponent: float | np.ndarray, corners: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the unit superellipse, [corners] each, or [L, corners] for exponents [L, 1]."""
    angle = np.arange(corners) * (2 * np.pi / corners)
    power = 2 / np.asarray(exponent, dtype=float)
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.sign(cosine) * np.abs(cosine) ** power, np.sign(sine) * np.abs(sine) ** power


def _along(extent: Extent, count: int) -> np.ndarray:
    """The extent at each of `count` points."""
    if isinstance(extent, tuple):
        return np.linspace(*extent, count)
    return np.broadcast_to(np.asarray(extent, dtype=float), (count,))


def _dome_ends(
    path: np.ndarray, width: np.ndarray, height: np.ndarray, tangent: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Add shrinking rings at both ends, so that a tube ends in a dome as long as it is thick."""
    angle = np.deg2rad([78.0, 52.0, 26.0])
    shrink, reach = np.cos(angle), np.sin(angle)
    first, last = min(width[0], height[0]), min(width[-1], height[-1])
    before = path[0] - first * reach[:, None] * tangent[0]
    beyond = path[-1] + last * reach[::-1, None] * tangent[-1]
    path = np.concatenate([before, path, beyond])
    width = np.concatenate([width[0] * shrink, width, width[-1] * shrink[::-1]])
    height = np.concatenate([height[0] * shrink, height, height[-1] * shrink[::-1]])
    tangent = np.concatenate([np.repeat(tangent[:1], 3, 0), tangent, np.repeat(tangent[-1:], 3, 0)])
    return path, width, height, tangent


def _inset(outline: np.ndarray, distance: float) -> np.ndarray:
    """Move every vertex of a counter-clockwise outline inwards, mitred, at most twice as far."""
    if distance == 0:
        return outline
    edge = np.roll(outline, -1, axis=0) - outline
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    normal = np.column_stack([-edge[:, 1], edge[:, 0]])
    before = np.roll(normal, 1, axis=0)
    half_cosine = 1 + np.sum(normal * before, axis=1, keepdims=True)
    return outline + distance * (normal + before) / np.maximum(half_cosine, 0.5)


def _same_turns(outlines: Sequence[np.ndarray], insets: Sequence[np.ndarray]) -> bool:
    """Whether no edge has turned around, and the inset outlines still bound the same region."""
    for outline, inset in zip(outlines, insets, strict=True):
        edge = np.roll(outline, -1, axis=0) - outline
        moved = np.roll(inset, -1, axis=0) - inset
        if np.any(np.sum(edge * moved, axis=1) <= 0):
            return False
    simple, area = CrossSection(list(insets)), sum(map(signed_area, insets))
    as_large = bool(np.isclose(simple.area(), area, rtol=1e-5))
    return as_large and simple.num_contour() == len(outlines)
