"""Reader of a URDF for grasping: the tree of joints, their limits, the collision shapes."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.untrusted import read_xml
from pointsdf_cli.robot.shapes import Shape, mesh_file, mesh_shape, require_metres

MOVING = ("revolute", "continuous", "prismatic")
JOINT_KINDS = (*MOVING, "fixed")
PRIMITIVES = {
    "box": (("size",), 3),
    "cylinder": (("radius", "length"), 2),
    "sphere": (("radius",), 1),
}
"""Attributes with the sizes of a shape, and how many numbers they hold."""
MOST = {"link": 1000, "joint": 1000, "link/collision": 2000}
"""Elements of each kind in the largest robot: times grow with the square of their number."""


@dataclass(frozen=True)
class Joint:
    """One joint of the tree.

    Attributes:
        kind: One of `JOINT_KINDS`.
        T_parent_joint: [4, 4], the child link's frame in the parent's where the joint is at 0.
        axis: [3], unit, in the child's frame.
        lower, upper: Limits [rad or m]; ±π where the URDF gives none.
        velocity: Largest speed [rad/s or m/s].
        effort: Largest torque or force [N m or N].
        mimic: Name of the joint that moves this one along, and by how much of its motion;
            None for a joint of its own.
    """

    name: str
    kind: str
    parent: str
    child: str
    T_parent_joint: Array
    axis: Array
    lower: float
    upper: float
    velocity: float
    effort: float
    mimic: tuple[str, float] | None = None


@dataclass(frozen=True)
class Tree:
    """Links in an order in which every parent stands before its children.

    Attributes:
        links: Link names; the first is the root.
        joints: `joints[i]` leads to `links[i + 1]`.
        shapes: Collision shapes by link name, in the link's frame.
        without_mass: Links that have shapes and no `<inertial>` with a mass above 0.
    """

    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    shapes: dict[str, tuple[Shape, ...]]
    without_mass: tuple[str, ...]

    @cached_property
    def parent_joint(self) -> dict[str, Joint]:
        """The joint that leads to each link but the root."""
        return {joint.child: joint for joint in self.joints}

    def joints_to_root(self, link: str) -> list[Joint]:
        """The joints from a link up to the root."""
        way: list[Joint] = []
        while link in self.parent_joint:
            way.append(self.parent_joint[link])
            link = way[-1].parent
        return way

    def subtree(self, links: Iterable[str]) -> tuple[str, ...]:
        """Some links and all beyond them, in the order of `links`."""
        found = set(links)
        for joint in self.joints:  # parents come first
            if joint.parent in found:
                found.add(joint.child)
        return tuple(link for link in self.links if link in found)

    def links_moved_by(self, joints: Collection[str]) -> tuple[str, ...]:
        """The links that some joints move, in the order of `links`."""
        return self.subtree(joint.child for joint in self.joints if joint.name in joints)

    def fixed_to_root(self) -> tuple[str, ...]:
        """The links that no joint moves, the root first."""
        moved = set(
            self.links_moved_by({joint.name for joint in self.joints if joint.kind != "fixed"})
        )
        return tuple(link for link in self.links if link not in moved)

    def neighbours(self) -> set[frozenset[str]]:
        """Pairs of links that cannot be kept apart by moving: those that one joint connects,
        directly or across links without shape, and those that fixed joints make one body."""
        body: dict[str, str] = {}
        pairs = set()
        for link in self.links:  # parents first
            joint = self.parent_joint.get(link)
            fixed = joint is not None and joint.kind == "fixed"
            body[link] = body[joint.parent] if joint and fixed else link
            pairs |= {frozenset((link, other)) for other in body if body[other] == body[link]}
            while joint is not None:
                pairs.add(frozenset((link, joint.parent)))
                joint = (
                    self.parent_joint.get(joint.parent) if not self.shapes[joint.parent] else None
                )
        return {pair for pair in pairs if len(pair) == 2}


def read_urdf(path: Path) -> Tree:
    """Read a URDF file.

    Raises:
        InputError: Not XML, not a URDF, a joint kind or shape that is not supported, a name used
            twice, no tree, or a mesh that cannot be found.
    """
    if not os.path.isfile(path):  # unlike Path's, it takes names of any length
        raise InputError("no such URDF file", where=path)
    root = read_xml(path)
    if root.tag != "robot":
        raise InputError(f"has the root <{root.tag}>", where=path, allowed="a URDF: <robot>")
    if any("xacro" in str(node.tag) for node in root.iter()):
        hint = f"ros2 run xacro xacro {path.name} > robot.urdf"
        raise InputError("holds elements of xacro", where=path, allowed="a URDF", hint=hint)
    for what, most in MOST.items():
        if len(found := root.findall(what)) > most:
            raise InputError(f"has {len(found)} <{what}>", where=path, allowed=f"{most}")
    nodes = root.findall("link")
    names = [_attribute(link, "name", path) for link in nodes]
    joints = [_joint(node, path) for node in root.findall("joint")]
    for kind, all_names in (("link", names), ("joint", [joint.name for joint in joints])):
        twice = sorted({name for name in all_names if all_names.count(name) > 1})
        if twice:
            raise InputError(f"names the {kind} {twice[0]!r} twice", where=path)
    shapes = {name: tuple(_shapes(link, path)) for name, link in zip(names, nodes, strict=True)}
    weighed = {link.get("name") for link in nodes if has_mass(link)}
    joints = [_following(joint, joints, path) for joint in joints]
    links, ordered = _ordered(names, joints, path)
    without_mass = tuple(name for name in links if shapes[name] and name not in weighed)
    return Tree(links, ordered, shapes, without_mass)


def has_mass(link: ET.Element) -> bool:
    """Whether a link of a URDF has an `<inertial>` with a mass above 0."""
    mass = link.find("inertial/mass")
    try:
        return mass is not None and float(mass.get("value", "0")) > 0
    except ValueError:
        return False


def _following(joint: Joint, joints: list[Joint], path: Path) -> Joint:
    """A joint that may follow another (`<mimic>`): a missing limit is its leader's, scaled.

    Raises:
        InputError: The leader does not move, or is or follows the joint itself.
    """
    if joint.mimic is None:
        return joint
    name, share = joint.mimic
    by_name = {one.name: one for one in joints if one.kind in MOVING}
    leader = first = by_name.get(name)
    for _ in joints:  # to the end of a chain, or around a circle
        if first and first.mimic:
            first = by_name.get(first.mimic[0])
    if leader is None or first is None or first.mimic:
        what = f"<mimic> of joint {joint.name!r} follows {name!r}"
        raise InputError(what, where=path, allowed="another moving joint of the URDF")
    if joint.kind != "continuous" and joint.lower < joint.upper:
        return joint
    leader = _following(leader, joints, path)
    ends = sorted((share * leader.lower, share * leader.upper))
    return replace(
        joint,
        lower=ends[0],
        upper=ends[1],
        velocity=joint.velocity or abs(share) * leader.velocity,
        effort=joint.effort or leader.effort,
    )


def _ordered(
    names: list[str], joints: list[Joint], path: Path
) -> tuple[tuple[str, ...], tuple[Joint, ...]]:
    """Links and joints from the root outwards, breadth first."""
    children = [joint.child for joint in joints]
    for joint in joints:
        if children.count(joint.child) > 1:
            what = f"link {joint.child!r} is the child of {children.count(joint.child)} joints"
            raise InputError(what, where=path, allowed="one")
        for link in (joint.parent, joint.child):
            if link not in names:
                what = f"joint {joint.name!r} names the link {link!r}"
                raise InputError(what, where=path, allowed=", ".join(names))
    roots = [name for name in names if name not in children]
    if len(roots) != 1:
        what = f"has {len(roots)} root links ({', '.join(roots[:4])})"
        raise InputError(what, where=path, allowed="one")
    links, ordered = [roots[0]], []
    for link in links:  # grows while it is walked
        for joint in joints:
            if joint.parent == link:
                ordered.append(joint)
                links.append(joint.child)
    if len(links) != len(names):
        raise InputError("its joints do not form a tree", where=path)
    return tuple(links), tuple(ordered)


def _joint(node: ET.Element, path: Path) -> Joint:
    name, kind = _attribute(node, "name", path), node.get("type", "")
    if kind not in JOINT_KINDS:
        what = f"joint {name!r} is of the kind {kind!r}"
        raise InputError(what, where=path, allowed=", ".join(JOINT_KINDS))
    ends = {}
    for role in ("parent", "child"):
        end = node.find(role)
        if end is None or not end.get("link"):
            raise InputError(f"joint {name!r} has no {role} link", where=path)
        ends[role] = str(end.get("link"))
    axis_node, limit = node.find("axis"), node.find("limit")
    axis = _vector(axis_node, "xyz", (1.0, 0.0, 0.0), path)
    length = float(np.linalg.norm(axis))
    if kind in MOVING and length < 1e-9:
        raise InputError(f"joint {name!r} has a zero axis", where=path)
    values = dict.fromkeys(("lower", "upper", "velocity", "effort"), 0.0)
    for key in values:
        text = None if limit is None else limit.get(key)
        values[key] = float(_numbers(text, 1, path)[0]) if text else 0.0
    follows = node.find("mimic") is not None
    if kind == "continuous" or (kind == "revolute" and limit is None and not follows):
        values["lower"], values["upper"] = -np.pi, np.pi
    return Joint(
        name=name,
        kind=kind,
        parent=ends["parent"],
        child=ends["child"],
        T_parent_joint=_origin(node, path),
        axis=axis / max(length, 1e-9),
        mimic=_mimic(node, path),
        **values,
    )


def _mimic(node: ET.Element, path: Path) -> tuple[str, float] | None:
    leader = node.find("mimic")
    if leader is None:
        return None
    share = float(_numbers(leader.get("multiplier", "1"), 1, path)[0])
    offset = float(_numbers(leader.get("offset", "0"), 1, path)[0])
    if share == 0 or offset != 0:
        raise InputError(
            f"<mimic> of joint {node.get('name')!r} has multiplier {share:g} and offset {offset:g}",
            where=path,
            allowed="a multiplier other than 0, without offset",
            hint="move the joint's origin by the offset",
        )
    return _attribute(leader, "joint", path), share


def _shapes(link: ET.Element, path: Path) -> list[Shape]:
    shapes, name = [], link.get("name")
    for part in link.findall("collision"):
        geometry = part.find("geometry")
        if geometry is None or not len(geometry):
            raise InputError(f"link {name!r} has a collision without shape", where=path)
        try:
            shapes.append(_shape(geometry[0], _origin(part, path), path))
        except InputError as error:
            what, where = f"link {name!r}: {error.what}", error.where or path
            raise InputError(what, where=where, allowed=error.allowed, hint=error.hint) from error
    return shapes


def _shape(node: ET.Element, pose: Array, path: Path) -> Shape:
    if node.tag == "mesh":
        scale = _vector(node, "scale", (1.0, 1.0, 1.0), path)
        return mesh_shape(mesh_file(node.get("filename", ""), path), scale, pose)
    if node.tag not in PRIMITIVES:
        allowed = ", ".join((*PRIMITIVES, "mesh"))
        raise InputError(f"the shape <{node.tag}>", where=path, allowed=allowed)
    keys, count = PRIMITIVES[node.tag]
    size = _numbers(" ".join(node.get(key, "") for key in keys), count, path)
    shape = Shape(node.tag, tuple(size.tolist()), pose)
    require_metres(shape.bounds(), f"a {node.tag}", path, "are its lengths in millimetres?")
    return shape


def _origin(node: ET.Element, path: Path) -> Array:
    origin = node.find("origin")
    roll, pitch, yaw = _vector(origin, "rpy", (0.0, 0.0, 0.0), path)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    # Fixed axes: R = Rz(yaw) Ry(pitch) Rx(roll), the URDF convention.
    rotation = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return transform(rotation, _vector(origin, "xyz", (0.0, 0.0, 0.0), path))


def _vector(node: ET.Element | None, key: str, default: tuple[float, ...], path: Path) -> Array:
    text = None if node is None else node.get(key)
    return np.array(default) if text is None else _numbers(text, len(default), path)


def _numbers(text: str | None, count: int, path: Path) -> Array:
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{text!r} is not {count} finite numbers", where=path)
    return values


def _attribute(node: ET.Element, key: str, path: Path) -> str:
    value = node.get(key)
    if not value:
        raise InputError(f"a <{node.tag}> has no {key}", where=path)
    return value
