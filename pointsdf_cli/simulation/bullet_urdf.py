"""A robot for PyBullet as everything else here takes it: the same hulls, and a mass for each link.

PyBullet reads a URDF by itself. Of meshes in some formats (text STL) it makes links without a body,
at others (PLY, OFF, GLB) it gives up, and a link without `<inertial>` weighs 1 kg. So a URDF that
has either is written anew, with the hulls of `robot/shapes.py` and masses of the links' volumes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.untrusted import read_xml
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.shapes import Shape
from pointsdf_cli.robot.urdf import mesh_file

LINK_DENSITY = 1000.0
"""Of a link whose mass the URDF does not give [kg/m³]."""
FRAME_MASS, FRAME_INERTIA = 1e-3, 1e-6
"""Of a link without shape or mass, which marks a place only [kg], [kg m²]: PyBullet needs some."""


def bullet_urdf(robot: RobotDescription, folder: Path, visible: bool = False) -> Path:
    """The file to load: the robot's own where PyBullet reads it rightly, else one in `folder`.

    Args:
        robot: The robot.
        folder: Where the URDF and the hulls go.
        visible: Keep what is only to be looked at.
    """
    root = read_xml(robot.urdf)
    links = root.findall("link")
    meshes = root.findall("link/collision/geometry/mesh")
    if not meshes and all(link.find("inertial") is not None for link in links):
        return robot.urdf
    for number, link in enumerate(links):
        shapes = robot.tree.shapes[str(link.get("name"))]
        for k, (node, shape) in enumerate(zip(link.findall("collision"), shapes, strict=True)):
            if shape.kind == "hull":
                file = folder / f"link{number}_{k}.obj"
                trimesh.Trimesh(*shape.triangles(), process=False).export(file)
                _name_mesh(node, file)
        if link.find("inertial") is None:
            link.append(_inertial(shapes))
        for visual in link.findall("visual"):
            if not visible or not _at_its_place(visual, robot.urdf):
                link.remove(visual)
    path = folder / "robot.urdf"
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _name_mesh(node: ET.Element, file: Path) -> None:
    """Let a collision's mesh be this file, which is in metres."""
    mesh = node.find("geometry/mesh")
    assert mesh is not None
    mesh.attrib.clear()
    mesh.set("filename", str(file))


def _at_its_place(visual: ET.Element, urdf: Path) -> bool:
    """Name a visual's mesh by its whole path; False if it is not there."""
    for mesh in visual.findall("geometry/mesh"):
        try:
            mesh.set("filename", str(mesh_file(str(mesh.get("filename", "")), urdf).resolve()))
        except InputError:
            return False
    return True


def _inertial(shapes: tuple[Shape, ...]) -> ET.Element:
    """Mass, centre of mass and inertia of what a link's collision shapes enclose."""
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
