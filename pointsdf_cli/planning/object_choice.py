"""Choice of the object to grasp, by the user or by default."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.table_objects import TableObjects
from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.robot.description import RobotDescription

TARGET_REACH = 0.1
"""Largest distance [m] from --target to the nearest seen point of the object it names."""

PIXEL_REACH = 15.0
"""Largest distance [px] from --target's pixel to the nearest pixel of the object it names."""

SIZE_POWER = 0.25
"""Exponent of an object's seen surface in its rank: size decides only between objects about equally
near to the middle of the image."""

SMALLEST_THING, LARGEST_THING, MISFIT = 0.015, 0.35, 0.3
"""Smallest and largest size [m] of an object worth grasping, and the merit of others, and of those
too wide for the robot's jaws."""


class NoObjectError(RgraspError):
    """The clouds show nothing that could be grasped."""

    exit_code = 3


@dataclass(frozen=True)
class TargetChoice:
    """The user's choice of an object; exactly one attribute is set.

    Attributes:
        number: Number in the list of objects, from 1.
        pixel: (u, v) of the image.
        place: [3], world, m.
        any: The first that can be grasped (`take_order.py`).

    Raises:
        InputError: None or several are set, or numbers that are no place or pixel.
    """

    number: int | None = None
    pixel: tuple[float, float] | None = None
    place: Array | None = None
    any: bool = False

    def __post_init__(self) -> None:
        given = [self.number, self.pixel, self.place, self.any or None]
        if sum(each is not None for each in given) != 1:
            allowed = "number, pixel, place or any"
            raise InputError("not one choice", where="TargetChoice", allowed=allowed)
        number = self.number
        is_whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if number is not None and not is_whole:
            what, allowed = f"no object {number!r}", "a number in the list of objects, from 1"
            raise InputError(what, where="target", allowed=allowed)
        for numbers, count in ((self.pixel, 2), (self.place, 3)):
            if numbers is not None and not _are_finite(numbers, count):
                others = "TargetChoice(number=…, pixel=(u, v), any=True)"
                allowed = f"[3], a place in the world, m; or {others}"
                wrong = f"{numbers!r} is no place of an object"
                raise InputError(wrong, where="target", allowed=allowed)


@dataclass(frozen=True)
class ListedObject:
    """One observed object.

    Attributes:
        number: Number from 1; 1 is the default target.
        label: Its label in `TableObjects.label`.
        centre: [3], centre of its bounding box, world, m.
        size: [3], sides of its box: the longer and the shorter horizontal side, and its height, m.
        points: Number of observed points, thinned.
        stands: Whether it stands on the table; others come last.
        unsplit: Whether it looks like several objects in contact.
        image: [2], its place in the image, in units of half the image: (0, 0) is the middle.
    """

    number: int
    label: int
    centre: Array
    size: Array
    points: int
    stands: bool
    unsplit: bool
    image: Array

    def describe(self) -> str:
        """Describe place and size in words."""
        x, y, z = self.centre
        return f"at {x:.2f},{y:.2f},{z:.2f} m, {self.sides}"

    @property
    def sides(self) -> str:
        """The size in words."""
        a, b, c = self.size * 100
        return f"{a:.0f} × {b:.0f} × {c:.0f} cm"


class Reach(NamedTuple):
    """Part of the table that a robot's palm reaches, and what fits its hand.

    Attributes:
        base: [2], place of the robot's base, world, m.
        near, far: Level distances from it between which the palm gets near the table [m].
        opening: Width of what fits between the jaws [m]; infinite for a hand without.
    """

    base: Array
    near: float
    far: float
    opening: float = np.inf

    def fits(self, size: Array) -> bool:
        """Whether the jaws fit around the shortest side of an object of sides [3], m."""
        return float(size.min()) < self.opening

    def beyond(self, place: Array) -> float:
        """Level distance [m] of a place [2 or 3] of the world from the reach; 0 within it."""
        level = float(np.linalg.norm(place[:2] - self.base))
        return max(self.near - level, level - self.far, 0.0)


@functools.lru_cache(maxsize=8)
def reach_of(robot: RobotDescription) -> Reach:
    """The reach of a robot, from random configurations of its arm."""
    from pointsdf_cli.robot.jaws import jaws_of
    from pointsdf_cli.robot.kinematics import Kinematics

    kinematics = Kinematics(robot)
    rng = np.random.default_rng(0)
    low, high = robot.lower[robot.arm], robot.upper[robot.arm]
    q = np.broadcast_to(robot.home, (2000, len(robot.home))).copy()
    q[:, robot.arm] = rng.uniform(low, high, (2000, len(low)))
    palm = kinematics.palm(q).numpy()[:, :3, 3]
    near = palm[(palm[:, 2] > 0.0) & (palm[:, 2] < 0.4)]
    if len(near) < 50:
        near = palm
    base = robot.T_world_base[:2, 3]
    level = np.linalg.norm(near[:, :2] - base, axis=1)
    jaws = jaws_of(robot)
    opening = np.inf if jaws is None else jaws.room
    return Reach(base, float(np.percentile(level, 20)), float(np.percentile(level, 90)), opening)


def numbered(
    points: Array,
    image: Array,
    objects: TableObjects,
    standing: NDArray[np.bool_],
    reach: Reach | None = None,
) -> list[ListedObject]:
    """Number the objects, best to grasp first.

    An object near the middle of the image, within the robot's reach and of a size that its hand
    grasps comes first: people point a camera at the object they mean.

    Args:
        points: [N, 3], world, m, one a voxel.
        image: [N, 2], places in the image, in units of half its size.
        objects: The object of each point.
        standing: bool [T], which objects stand on the table.
        reach: Result of `reach_of`; None if the robot's pose is not known.
    """
    found = []
    for one in range(objects.count):
        mine = objects.label == one
        if not mine.any():
            continue
        seen = points[mine]
        low, high = np.percentile(seen, [0.5, 99.5], axis=0)
        item = ListedObject(
            number=0,
            label=one,
            centre=(low + high) / 2,
            size=_sides(seen, objects.plane_below(one) if standing[one] else None),
            points=len(seen),
            stands=bool(standing[one]),
            unsplit=one in objects.unsplit,
            image=np.median(image[mine], axis=0),
        )
        found.append((_merit(item, reach) * item.points**SIZE_POWER, item))
    # What stands on a tray is meant, and not the tray.
    carries = objects.supports if objects.raised else ()
    found.sort(key=lambda pair: (not pair[1].stands, pair[1].label in carries, -pair[0]))
    return [replace(item, number=k) for k, (_, item) in enumerate(found, 1)]


def choose(
    objects: list[ListedObject],
    target: TargetChoice | None,
    points: Array,
    label: NDArray[np.int64],
    pixels: Array | None,
    where: str,
) -> ListedObject:
    """The object that the user chose; the first without a choice.

    Args:
        objects: Result of `numbered`.
        target: The user's choice.
        points, label: Points as for `numbered`, and the label of each.
        pixels: [N, 2], (u, v) of the points; None without an image.
        where: Name of the cloud, for messages.

    Raises:
        InputError: No object has this number, the pixel is outside the image or there is no image,
            or the choice is not one object.
        NoObjectError: There is no object, or none at this place.
    """
    if not objects:
        raise NoObjectError("nothing stands on the table", where=where)
    if target is None:
        return objects[0]
    if target.any:
        wrong, allowed = "`any` does not name one object", "a number, U,V or X,Y,Z"
        raise InputError(wrong, where="--target", allowed=allowed)
    if target.number is not None:
        return _of_number(objects, target.number, where)
    by_label = {item.label: item for item in objects}
    mine = np.isin(label, list(by_label))
    if target.pixel is not None:
        if pixels is None:
            raise InputError(
                "a pixel, but the cloud has no image",
                where="--target",
                allowed="a number, or X,Y,Z in the world",
                hint="add --intrinsics K.json, or give the depth image instead of the cloud",
            )
        away = np.linalg.norm(pixels[mine] - np.asarray(target.pixel), axis=1)
        if away.min() > PIXEL_REACH:
            raise NoObjectError(
                f"no object at the pixel {target.pixel[0]:g},{target.pixel[1]:g}: the nearest one "
                f"is {away.min():.0f} pixels away",
                where=where,
                hint="rgrasp segment, with the same options, shows what there is",
            )
    else:
        away = np.linalg.norm(points[mine] - np.asarray(target.place), axis=1)
        if away.min() > TARGET_REACH:
            raise NoObjectError(
                f"the object nearest to --target is {away.min():.2f} m away from it",
                where=where,
                hint=f"give a place within {TARGET_REACH:g} m of an object in the world; rgrasp "
                "segment, with the same options, lists them",
            )
    return by_label[int(label[mine][away.argmin()])]


def _of_number(objects: list[ListedObject], number: int, where: str) -> ListedObject:
    if not 1 <= number <= len(objects):
        standing = [item for item in objects if item.stands] or objects
        there = "; ".join(f"{item.number} {item.describe()}" for item in standing)
        raise InputError(f"no object {number}", where="--target", allowed=f"of {where}: {there}")
    return objects[number - 1]


def _are_finite(numbers: Any, count: int) -> bool:
    try:
        array = np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return array.shape == (count,) and bool(np.isfinite(array).all())


def _sides(points: Array, table: Array | None) -> Array:
    """Sides [3] of the smallest upright box around points [N, 3], the longer level one first.

    Args:
        points: Seen points of an object, world, m.
        table: Plane [4] that it stands on, where the box ends; None if it is not known.
    """
    angle = np.linspace(0, np.pi / 2, 30, endpoint=False)
    turn = np.stack([np.cos(angle), np.sin(angle)])
    along, across = points[:, :2] @ turn, points[:, :2] @ np.stack([-turn[1], turn[0]])
    extent = [np.ptp(np.percentile(each, [0.5, 99.5], axis=0), axis=0) for each in (along, across)]
    best = int((extent[0] * extent[1]).argmin())
    a, b = sorted((float(extent[0][best]), float(extent[1][best])), reverse=True)
    low, high = np.percentile(points[:, 2], [0.5, 99.5])
    if table is not None:
        low = (table[3] - table[:2] @ np.median(points[:, :2], axis=0)) / table[2]
    return np.array([a, b, high - low])


def _merit(item: ListedObject, reach: Reach | None) -> float:
    """Merit of an object as a target: 1 is the best."""
    centred = float(np.exp(-((np.linalg.norm(item.image) / 0.6) ** 2)))
    near, fits = 1.0, SMALLEST_THING < float(item.size.max()) < LARGEST_THING
    if reach is not None:
        near = float(np.exp(-((reach.beyond(item.centre) / 0.12) ** 2)))
        fits = fits and reach.fits(item.size)
    return centred * near * (1.0 if fits else MISFIT)
