"""Robots of boxes, cylinders and spheres, and the URDF of them.

Every link is a union of primitives that serves as visual, collision shape and, with its mass spread
over the union by volume, as inertia. Units: m, rad, kg, N m, rad/s; N and m/s for sliding joints.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Shape:
    """One primitive: `size` is (x, y, z) of a box, (radius, length) of a cylinder along z,
    (radius,); `rpy` turns it about its centre, as in a URDF."""

    kind: str
    size: tuple[float, ...]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def volume(self) -> float:
        if self.kind == "box":
            return math.prod(self.size)
        if self.kind == "cylinder":
            return math.pi * self.size[0] ** 2 * self.size[1]
        return 4 / 3 * math.pi * self.size[0] ** 3

    def unit_inertia(self) -> np.ndarray:
        """Inertia [3, 3] about its own centre for a mass of 1 kg, in the link's axes."""
        if self.kind == "box":
            x, y, z = (s * s for s in self.size)
            own = np.diag([y + z, x + z, x + y]) / 12
        elif self.kind == "cylinder":
            radius, length = self.size
            side = (3 * radius**2 + length**2) / 12
            own = np.diag([side, side, radius**2 / 2])
        else:
            own = np.eye(3) * 0.4 * self.size[0] ** 2
        turn = Rotation.from_euler("xyz", self.rpy).as_matrix()
        return np.asarray(turn @ own @ turn.T)


@dataclass(frozen=True)
class Link:
    """A link with its mass and shapes; `spinning_friction` [m] as PyBullet reads it in `<contact>`:
    torsional friction of a soft surface, times the other body's lateral friction and the force."""

    name: str
    mass: float
    shapes: list[tuple[Shape, str]]
    spinning_friction: float = 0.0


@dataclass(frozen=True)
class Joint:
    """A joint from `parent` to `child`; `kind` is revolute, prismatic or fixed; it moves as the
    joint `mimic` does, if that is named, times `multiplier`."""

    name: str
    parent: str
    child: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    limit: tuple[float, float] = (0.0, 0.0)
    effort: float = 0.0
    velocity: float = 0.0
    damping: float = 0.0
    kind: str = "revolute"
    mimic: str = ""
    multiplier: float = 1.0


@dataclass
class Model:
    links: list[Link] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)


def tube(radius: float, start: float, end: float, x: float = 0.0) -> Shape:
    """A cylinder along z."""
    return Shape("cylinder", (radius, end - start), (x, 0, (start + end) / 2))


def drum(radius: float, start: float, end: float, x: float = 0.0) -> Shape:
    """A cylinder along y: the housing of a joint."""
    centre = (x, (start + end) / 2, 0.0)
    return Shape("cylinder", (radius, end - start), centre, (math.pi / 2, 0, 0))


RUBBER = 1.5e6
"""Young's modulus of rubber [Pa], that of GraspIt!'s soft fingers (manual, chapter 6)."""
POISSON, CURVATURE = 0.5, 0.03
"""Poisson's ratio of rubber; radius of what the jaws usually grasp [m]."""
OBJECT = 1e-3 / 0.6
"""Part that PyBullet adds for the object: its own torsional over its lateral friction [m]
(`simulation/physics.py`)."""


def rubber_friction(force: float) -> float:
    """Torsional friction of a rubber pad pressed by `force` [N], over lateral friction and force:
    [m].

    The contact of a ball with a rubber half-space is a disc of radius a, a³ = 3 F R (1 − ν²) / 4 E
    (Hertz); its pressure resists a torque of 3π/16 a μ F.
    """
    disc = (3 * force * CURVATURE * (1 - POISSON**2) / (4 * RUBBER)) ** (1 / 3)
    return 3 * math.pi / 16 * disc - OBJECT


def inertial(link: Link) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass [3] and inertia [3, 3] about it, the mass spread evenly over the shapes."""
    volumes = np.array([shape.volume for shape, _ in link.shapes])
    masses = link.mass * volumes / volumes.sum()
    centres = np.array([shape.centre for shape, _ in link.shapes], float)
    centre = masses @ centres / link.mass
    inertia = np.zeros((3, 3))
    for mass, (shape, _), place in zip(masses, link.shapes, centres, strict=True):
        d = place - centre
        inertia += mass * (shape.unit_inertia() + (d @ d) * np.eye(3) - np.outer(d, d))
    return centre, inertia


def text(values: object) -> str:
    return " ".join(f"{v:.9g}" for v in np.atleast_1d(np.asarray(values, float)))


def urdf(model: Model, robot: str, colours: Mapping[str, str]) -> ET.Element:
    """The model as a URDF tree; `colours` gives the RGBA of each colour's name."""
    root = ET.Element("robot", name=robot)
    for name, rgba in colours.items():
        ET.SubElement(ET.SubElement(root, "material", name=name), "color", rgba=rgba)
    for link in model.links:
        node = ET.SubElement(root, "link", name=link.name)
        centre, inertia = inertial(link)
        mass_node = ET.SubElement(node, "inertial")
        ET.SubElement(mass_node, "origin", xyz=text(centre), rpy="0 0 0")
        ET.SubElement(mass_node, "mass", value=text(link.mass))
        keys = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2)}
        keys["izz"] = (2, 2)
        values = {key: text(inertia[at]) for key, at in keys.items()}
        ET.SubElement(mass_node, "inertia", attrib=values)
        if link.spinning_friction:
            contact = ET.SubElement(node, "contact")
            ET.SubElement(contact, "spinning_friction", value=text(link.spinning_friction))
        for role in ("visual", "collision"):
            for shape, colour in link.shapes:
                part = ET.SubElement(node, role)
                ET.SubElement(part, "origin", xyz=text(shape.centre), rpy=text(shape.rpy))
                geometry = ET.SubElement(part, "geometry")
                if shape.kind == "box":
                    ET.SubElement(geometry, "box", size=text(shape.size))
                elif shape.kind == "cylinder":
                    radius, length = (text(v) for v in shape.size)
                    ET.SubElement(geometry, "cylinder", radius=radius, length=length)
                else:
                    ET.SubElement(geometry, "sphere", radius=text(shape.size))
                if role == "visual":
                    ET.SubElement(part, "material", name=colour)
    for joint in model.joints:
        node = ET.SubElement(root, "joint", name=joint.name, type=joint.kind)
        ET.SubElement(node, "parent", link=joint.parent)
        ET.SubElement(node, "child", link=joint.child)
        ET.SubElement(node, "origin", xyz=text(joint.xyz), rpy=text(joint.rpy))
        if joint.kind == "fixed":
            continue
        ET.SubElement(node, "axis", xyz=text(joint.axis))
        lower, upper = (text(v) for v in joint.limit)
        ET.SubElement(
            node,
            "limit",
            lower=lower,
            upper=upper,
            effort=text(joint.effort),
            velocity=text(joint.velocity),
        )
        if joint.mimic:
            multiplier = text(joint.multiplier)
            ET.SubElement(node, "mimic", joint=joint.mimic, multiplier=multiplier, offset="0")
        ET.SubElement(node, "dynamics", damping=text(joint.damping), friction="0")
    ET.indent(root)
    return root


def write_urdf(script: str, model: Model, colours: Mapping[str, str]) -> None:
    """Write the URDF of make_NAME.py beside it, as NAME.urdf."""
    name = Path(script).stem.removeprefix("make_")
    path = Path(script).with_name(f"{name}.urdf")
    note = f"<!-- Written by make_{name}.py; edit that. -->"
    body = ET.tostring(urdf(model, name, colours), encoding="unicode")
    path.write_text(f'<?xml version="1.0"?>\n{note}\n{body}\n', encoding="utf-8")
    print(f"wrote {path}")
