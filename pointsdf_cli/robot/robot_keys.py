"""Keys of a robot's YAML file: typed values, or an error that names the key."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import rotation_from_wxyz, transform
from pointsdf_cli.robot.urdf import Joint, Tree

REQUIRED = ("urdf", "arm_joints", "hand_joints", "preshape_joints", "closing_joints", "palm")
OPTIONAL = ("name", "mount", "links_on_table", "arm_limit_margin", "home", "may_touch")

MOST_TURN = 20.0
"""Largest range of a joint with stops [rad], three turns: degrees are more."""


class RobotKeys:
    """Typed values of a robot's YAML mapping; an error names the file and the key.

    Args:
        path: The YAML file.
        data: Its contents.

    Raises:
        InputError: No mapping, a key that is missing, or one that is unknown.
    """

    def __init__(self, path: Path, data: Any) -> None:
        self.path = path
        if not isinstance(data, Mapping):
            raise InputError("is not a mapping of keys", where=path, allowed=", ".join(REQUIRED))
        self.data = data
        missing = [key for key in REQUIRED if key not in data]
        if missing:
            allowed = f"needed: {', '.join(REQUIRED)}"
            raise InputError(f"lacks {', '.join(missing)}", where=path, allowed=allowed)
        unknown = [str(key) for key in data if key not in REQUIRED + OPTIONAL]
        if unknown:
            raise self.wrong(unknown[0], "is not a key", ", ".join(REQUIRED + OPTIONAL))

    def wrong(self, key: str, what: str, allowed: str) -> InputError:
        """Error of a key that cannot be used."""
        return InputError(f"`{key}` {what}", where=self.path, allowed=allowed)

    def names(self, key: str, known: Mapping[str, Joint]) -> tuple[str, ...]:
        """Joint names of a list, each one known and there once."""
        names = self.data[key]
        if not isinstance(names, list) or not names:
            raise self.wrong(key, "is not a list of joints", ", ".join(known))
        self._require_known(key, names, tuple(known), "moving joints: ")
        if len(set(names)) != len(names):
            raise self.wrong(key, "names a joint twice", "each joint once")
        return tuple(names)

    def check_limits(self, joints: list[Joint]) -> None:
        """Refuse joints without a range, a speed or a torque, and ranges in degrees."""
        urdf = self.path.parent / str(self.data["urdf"])
        for joint in joints:
            if joint.kind == "revolute" and joint.upper - joint.lower > MOST_TURN:
                raise InputError(
                    f"joint {joint.name!r} turns from {joint.lower:g} to {joint.upper:g} rad",
                    where=urdf,
                    allowed=f"a range of up to {MOST_TURN:g} rad",
                    hint='limits in degrees? Or type="continuous", if nothing stops it',
                )
            if joint.lower >= joint.upper or joint.velocity <= 0 or joint.effort <= 0:
                raise InputError(
                    f"joint {joint.name!r} has lower {joint.lower:g}, upper {joint.upper:g}, "
                    f"velocity {joint.velocity:g}, effort {joint.effort:g}",
                    where=urdf,
                    allowed="lower below upper, velocity and effort above 0",
                )

    def mapping(self, key: str, hand: tuple[str, ...]) -> dict[str, Any]:
        """Mapping from joints of the hand."""
        value = self.data[key]
        if not isinstance(value, Mapping) or not value:
            raise self.wrong(key, "is not a mapping of joints", ", ".join(hand))
        self._require_known(key, value, hand, "hand joints: ")
        return dict(value)

    def vector(self, key: str, value: Any, count: int) -> Array:
        """`count` finite numbers [count]."""
        try:
            numbers = np.array([float(v) for v in value])
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if len(numbers) != count or not np.isfinite(numbers).all():
            raise self.wrong(key, f"holds {value!r}", f"{count} finite number(s)")
        return numbers

    def number(self, key: str, default: float, low: float, high: float) -> float:
        """Number from `low` to `high`."""
        value = float(self.vector(key, [self.data.get(key, default)], 1)[0])
        if not low <= value <= high:
            raise self.wrong(key, f"is {value}", f"{low:g} to {high:g}")
        return value

    def pose(self, key: str, value: Any, beside: tuple[str, ...] = ()) -> Array:
        """Transform [4, 4] of `xyz` [m] and `wxyz`; `beside` names further keys."""
        if not isinstance(value, Mapping):
            raise self.wrong(key, f"is {value!r}", "{xyz: [x, y, z], wxyz: [w, x, y, z]}")
        known = ("xyz", "wxyz", *beside)
        unknown = [one for one in value if one not in known]
        if unknown:
            raise self.wrong(key, f"has {unknown[0]!r}, which is not a key", ", ".join(known))
        wxyz = self.vector(key, value.get("wxyz", [1, 0, 0, 0]), 4)
        if abs(np.linalg.norm(wxyz) - 1) > 1e-3:
            raise self.wrong(key, f"has wxyz {wxyz.tolist()}", "a unit quaternion, w first")
        xyz = self.vector(key, value.get("xyz", [0, 0, 0]), 3)
        return read_only(transform(rotation_from_wxyz(wxyz), xyz))

    def links(self, key: str, tree: Tree) -> list[str]:
        """Link names of a list; empty where the key is missing."""
        value = self.data.get(key) or []
        if not isinstance(value, list):
            raise self.wrong(key, f"is {value!r}", "a list of links")
        self._require_known(key, value, tree.links)
        return list(value)

    def _require_known(
        self, key: str, names: Iterable[Any], known: tuple[str, ...], what: str = ""
    ) -> None:
        for name in names:
            if name not in known:
                raise self.wrong(key, f"names {name!r}", what + ", ".join(known))

    def pairs(self, tree: Tree) -> frozenset[frozenset[str]]:
        """Pairs of links of `may_touch`."""
        pairs = set()
        value = self.data.get("may_touch") or []
        if not isinstance(value, list):
            raise self.wrong("may_touch", f"is {value!r}", "a list of pairs of links")
        for pair in value:
            if (
                not isinstance(pair, list)
                or not all(isinstance(link, str) for link in pair)
                or len(set(pair)) != 2
                or not set(pair) <= set(tree.links)
            ):
                raise self.wrong("may_touch", f"holds {pair!r}", "pairs of two different links")
            pairs.add(frozenset(pair))
        return frozenset(pairs)


def read_only(array: Array) -> Array:
    """`array` itself, made read-only."""
    array.flags.writeable = False
    return array
