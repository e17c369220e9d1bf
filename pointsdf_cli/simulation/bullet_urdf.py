"""URDF of a robot for PyBullet, with the same hulls as in planning and a mass for each link.

PyBullet's own reader creates links without a body for meshes in some formats (text STL), fails for
others (PLY, OFF, GLB), and assumes 1 kg for a link without `<inertial>`. A URDF with any of these
is therefore rewritten, with the hulls of `robot/shapes.py` and masses from the links' volumes. A
URDF with hulls or cylinders is rewritten too, because PyBullet enlarges these (`skin.py`).

The hand alone is several files, one for the parts fixed to the palm and one for each finger: the
time of a PyBullet step grows with the square of a body's joints, so five small bodies are several
times as fast as one of 23 joints.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Container
from pathlib import Path

import numpy as np
import trimesh

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform
from pointsdf_cli.io.scratch import temporary_files
from pointsdf_cli.io.untrusted import read_xml
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.shapes import Shape
from pointsdf_cli.robot.urdf import MOVING, has_mass
from pointsdf_cli.simulation.skin import shrunk, shrunk_cylinder

LINK_DENSITY = 1000.0
"""Density of a link whose mass the URDF omits [kg/m³]."""
FRAME_MASS, FRAME_INERTIA = 1e-3, 1e-6
"""Mass [kg] and inertia [kg m²] of a link without shape or mass: PyBullet needs some."""


def bullet_urdf(robot: RobotDescription, folder: Path, skin: float) -> Path:
    """URDF file to load: the robot's own if PyBullet reads it correctly, else one in `folder`.

    Args:
        robot: The robot.
        folder: Folder for the URDF and the hulls.
        skin: `PhysicsConfig.skin`.
    """
    root = read_xml(robot.urdf)
    links = root.findall("link")
    geometry = "link/collision/geometry/"
    hulls = [*root.iterfind(geometry + "mesh"), *root.iterfind(geometry + "cylinder")]
    unit = all(abs(np.linalg.norm(axis) - 1) < 1e-6 for axis in map(_axis_of, root.iter("axis")))
    if not hulls and unit and all(has_mass(link) for link in links):
        return robot.urdf
    return _written(_readable(robot, folder, skin), folder / "robot.urdf")


def hand_urdfs(robot: RobotDescription, folder: Path, skin: float) -> list[Path]:
    """Write the hand as several bodies, each with its root at the palm link's pose.

    Args:
        robot: The robot.
        folder: Folder for the URDFs and the hulls.
        skin: `PhysicsConfig.skin`.

    Returns:
        First the links fixed to the palm, a flange in front of it included; then one file for each
        moving joint at these links, or for each group of coupled joints.
    """
    root = _readable(robot, folder, skin)
    links = {str(link.get("name")): link for link in root.findall("link")}
    joints = {str(joint.find("child").get("link")): joint for joint in root.findall("joint")}  # type: ignore[union-attr]
    carrier, base = _free_name("carrier", links), _free_name("base", links)
    fixed = _fixed_to_palm(robot)
    palm = _body([links[name] for name in fixed], [], carrier)
    for name, pose in fixed.items():
        palm.append(_fixed(carrier, name, pose))
    files = [_written(palm, folder / "palm.urdf")]
    for number, fingers in enumerate(_coupled(robot, _leading_away(robot, fixed))):
        inner = [name for name in robot.tree.subtree(fingers) if name not in fingers]
        inside = [links[name] for name in [*fingers, *inner]]
        finger = _body(inside, [joints[name] for name in inner], carrier)
        # PyBullet treats links fixed to the first link of a fixed base as part of the base, which
        # contacts cannot stop: a fingertip there would pass through the table.
        finger.append(_link_without_shape(base))
        finger.append(_fixed(carrier, base, np.eye(4)))
        for first, pose in fingers.items():
            finger.append(_led_from(base, joints[first], pose))
        files.append(_written(finger, folder / f"finger{number}.urdf"))
    return files


def _fixed_to_palm(robot: RobotDescription) -> dict[str, Array]:
    """Poses [4, 4] in the palm link of the links that cannot move in it."""
    fixed = {robot.palm_link: np.eye(4)}
    for joint in robot.tree.joints_to_root(robot.palm_link):
        if joint.kind in MOVING:
            break
        fixed[joint.parent] = fixed[joint.child] @ invert_transform(joint.T_parent_joint)
    for joint in robot.tree.joints:
        if joint.parent in fixed and joint.child not in fixed and joint.kind not in MOVING:
            fixed[joint.child] = fixed[joint.parent] @ joint.T_parent_joint
    return fixed


def _leading_away(robot: RobotDescription, fixed: dict[str, Array]) -> dict[str, Array]:
    """Each link whose joint moves it in the palm, and where that joint is in the palm link."""
    return {
        joint.child: fixed[joint.parent] @ joint.T_parent_joint
        for joint in robot.tree.joints
        if joint.parent in fixed and joint.child not in fixed
    }


def _coupled(robot: RobotDescription, fingers: dict[str, Array]) -> list[dict[str, Array]]:
    """The fingers, grouped so that joints coupled by <mimic> share a body: gears couple joints of
    one body only."""
    tree = robot.tree
    of_joint = {
        tree.parent_joint[link].name: one for one in fingers for link in tree.subtree([one])
    }
    group = {first: {first} for first in fingers}
    for joint in tree.joints:
        if joint.mimic and {joint.name, joint.mimic[0]} <= of_joint.keys():
            both = group[of_joint[joint.name]] | group[of_joint[joint.mimic[0]]]
            group |= dict.fromkeys(both, both)
    bodies = list(dict.fromkeys(frozenset(one) for one in group.values()))
    return [{first: pose for first, pose in fingers.items() if first in body} for body in bodies]


def _free_name(name: str, taken: Container[str]) -> str:
    while name in taken:
        name += "_"
    return name


def _body(links: list[ET.Element], joints: list[ET.Element], root_name: str) -> ET.Element:
    """A robot of these links and joints, and a root without a shape."""
    root = ET.Element("robot", name="hand")
    root.append(_link_without_shape(root_name))
    root.extend([*links, *joints])
    return root


def _link_without_shape(name: str) -> ET.Element:
    link = ET.Element("link", name=name)
    link.append(_inertial(()))
    return link


def _fixed(parent: str, child: str, pose: Array) -> ET.Element:
    """A joint that keeps a link at `pose` [4, 4] of another."""
    node = ET.Element("joint", name=f"{child} carried", type="fixed")
    ET.SubElement(node, "child", link=child)
    return _led_from(parent, node, pose)


def _led_from(parent: str, joint: ET.Element, pose: Array) -> ET.Element:
    """The joint at `pose` [4, 4] of another parent."""
    led = copy.deepcopy(joint)
    for node in [*led.findall("origin"), *led.findall("parent")]:
        led.remove(node)
    ET.SubElement(led, "parent", link=parent)
    led.append(_origin(pose))
    return led


def _origin(pose: Array) -> ET.Element:
    """Origin element of a pose [4, 4]: xyz, and rpy with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    m = pose[:3, :3]
    level = np.hypot(m[0, 0], m[1, 0])
    roll, yaw = np.arctan2(m[2, 1], m[2, 2]), np.arctan2(m[1, 0], m[0, 0])
    if level < 1e-9:  # straight up or down: roll and yaw turn about one axis, roll does it alone
        roll, yaw = np.arctan2(-m[1, 2], m[1, 1]), 0.0
    angles = np.array([roll, np.arctan2(-m[2, 0], level), yaw])
    return ET.Element("origin", xyz=_numbers(pose[:3, 3]), rpy=_numbers(angles))


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def _written(root: ET.Element, path: Path) -> Path:
    with temporary_files(path.parent):
        ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _readable(robot: RobotDescription, folder: Path, skin: float) -> ET.Element:
    """The URDF with hulls and masses, without visual meshes, which need not exist."""
    root = read_xml(robot.urdf)
    for number, link in enumerate(root.findall("link")):
        shapes = robot.tree.shapes[str(link.get("name"))]
        for k, (node, shape) in enumerate(zip(link.findall("collision"), shapes, strict=True)):
            if shape.kind == "hull":
                file = folder / f"link{number}_{k}.obj"
                corners, faces = shrunk(*shape.triangles(), skin)
                with temporary_files(folder):
                    trimesh.Trimesh(corners, faces, process=False).export(file)
                _name_mesh(node, file)
            elif shape.kind == "cylinder":
                _draw_in_cylinder(node, skin)
        if not has_mass(link):
            for empty in link.findall("inertial"):
                link.remove(empty)
            link.append(_inertial(shapes))
        for visual in link.findall("visual"):
            link.remove(visual)
    for node in root.iter("axis"):  # PyBullet scales a sliding joint by its length
        axis = _axis_of(node)
        node.set("xyz", _numbers(axis / max(float(np.linalg.norm(axis)), 1e-9)))
    return root


def _axis_of(node: ET.Element) -> Array:
    return np.array([float(value) for value in node.get("xyz", "1 0 0").split()])


def _name_mesh(node: ET.Element, file: Path) -> None:
    """Set a collision's mesh to this file, in metres."""
    mesh = node.find("geometry/mesh")
    assert mesh is not None
    mesh.attrib.clear()
    mesh.set("filename", str(file))
    node.attrib.pop("concave", None)  # triangles without an inside, and without a skin


def _draw_in_cylinder(node: ET.Element, skin: float) -> None:
    cylinder = node.find("geometry/cylinder")
    assert cylinder is not None
    radius, length = (float(cylinder.get(name, "")) for name in ("radius", "length"))
    radius, length = shrunk_cylinder(radius, length, skin)
    cylinder.set("radius", f"{radius:.9g}")
    cylinder.set("length", f"{length:.9g}")


def _inertial(shapes: tuple[Shape, ...]) -> ET.Element:
    """Mass and centre of mass of the volume of a link's collision shapes, and its inertia, which
    PyBullet replaces by its own of the same shapes."""
    mass, centre, inertia = FRAME_MASS, np.zeros(3), FRAME_INERTIA * np.eye(3)
    if shapes:
        body = trimesh.util.concatenate([shape.as_mesh() for shape in shapes])
        body.density = LINK_DENSITY
        mass, centre, inertia = body.mass, body.center_mass, body.moment_inertia
    node = ET.Element("inertial")
    ET.SubElement(node, "origin", xyz=" ".join(f"{value:.9g}" for value in centre))
    ET.SubElement(node, "mass", value=f"{mass:.9g}")
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2)}
    names["izz"] = (2, 2)
    moments = {name: f"{inertia[place]:.9g}" for name, place in names.items()}
    ET.SubElement(node, "inertia", moments)
    return node
