"""Writes panda.urdf: Franka Emika Panda with its parallel gripper, from primitives only.

Run it after a change of any number here: `python assets/robots/make_panda.py`. Joint frames, limits
and speeds are those of the maker's data sheet and DH table (Franka Control Interface
documentation, "Robot and interface specifications"); names are those of its URDF. Shapes are
primitives; no link of the maker's meshes stands out by more than 5 mm
(`tests/test_robot_bundled_panda.py`).
"""

from __future__ import annotations

import math

import primitives
from primitives import Joint, Link, Model, Shape, write_urdf

WHITE, GREY, DARK = "panda_white", "panda_grey", "pad_dark"
COLOURS = {WHITE: "0.92 0.93 0.94 1", GREY: "0.60 0.62 0.65 1", DARK: "0.18 0.18 0.20 1"}

QUARTER = math.pi / 2


Part = tuple[Shape, str]


def tube(radius: float, start: float, end: float) -> Part:
    return primitives.tube(radius, start, end), WHITE


def drum(radius: float, start: float, end: float, x: float = 0.0) -> Part:
    return primitives.drum(radius, start, end, x), WHITE


def box(
    size: tuple[float, float, float],
    centre: tuple[float, float, float],
    colour: str = WHITE,
    yaw: float = 0.0,
) -> Part:
    return Shape("box", size, centre, (0, 0, yaw)), colour


def ball(radius: float, x: float, y: float, z: float) -> Part:
    return Shape("sphere", (radius,), (x, y, z)), WHITE


def add_arm(model: Model) -> None:
    """Seven links on a base; the fifth is thick below and a thin forearm above."""
    model.links += [
        Link(
            "panda_link0",
            2.9,
            [tube(0.072, 0, 0.14), box((0.187, 0.19, 0.14), (-0.0615, 0, 0.07))],
        ),
        Link(
            "panda_link1",
            2.7,
            [tube(0.056, -0.192, 0), drum(0.056, -0.129, 0.056), ball(0.073, 0, -0.05, -0.045)],
        ),
        Link(
            "panda_link2",
            2.7,
            [tube(0.056, 0, 0.129), drum(0.056, -0.194, 0.056), ball(0.073, 0, -0.045, 0.05)],
        ),
        Link(
            "panda_link3",
            2.4,
            [
                tube(0.056, -0.121, 0.056),
                drum(0.056, -0.02, 0.111, x=0.0825),
                box((0.09, 0.09, 0.13), (0.04, 0.03, 0)),
            ],
        ),
        Link(
            "panda_link4",
            2.4,
            [
                tube(0.056, 0, 0.111),
                drum(0.056, 0, 0.124, x=-0.0825),
                box((0.09, 0.09, 0.11), (-0.04, 0.04, 0.02)),
            ],
        ),
        Link(
            "panda_link5",
            3.2,
            [
                tube(0.056, -0.26, -0.15),
                box((0.09, 0.05, 0.09), (0, 0.068, -0.21)),
                box((0.066, 0.066, 0.12), (0, 0.08, -0.105)),
                drum(0.052, 0.0, 0.13),
            ],
        ),
        Link(
            "panda_link6",
            1.5,
            [
                tube(0.049, -0.02, 0.056),
                drum(0.046, -0.051, 0.082, x=0.088),
                box((0.07, 0.12, 0.08), (0.045, 0.015, 0.01)),
            ],
        ),
        Link(
            "panda_link7",
            0.7,
            [
                tube(0.045, 0.052, 0.107),
                box((0.162, 0.08, 0.05), (0.0184, 0.0184, 0.08), GREY, math.pi / 4),
            ],
        ),
    ]
    fast, slow, strong, weak = 2.61, 2.175, 87.0, 12.0
    rows = [  # origin, turn about x, limit, effort, velocity
        ((0, 0, 0.333), 0, (-2.8973, 2.8973), strong, slow),
        ((0, 0, 0), -QUARTER, (-1.7628, 1.7628), strong, slow),
        ((0, -0.316, 0), QUARTER, (-2.8973, 2.8973), strong, slow),
        ((0.0825, 0, 0), QUARTER, (-3.0718, -0.0698), strong, slow),
        ((-0.0825, 0.384, 0), -QUARTER, (-2.8973, 2.8973), weak, fast),
        ((0, 0, 0), QUARTER, (-0.0175, 3.7525), weak, fast),
        ((0.088, 0, 0), QUARTER, (-2.8973, 2.8973), weak, fast),
    ]
    for i, (xyz, turn, limit, effort, velocity) in enumerate(rows, start=1):
        parent, child = f"panda_link{i - 1}", f"panda_link{i}"
        model.joints.append(
            Joint(
                f"panda_joint{i}",
                parent,
                child,
                xyz,
                (turn, 0, 0),
                limit=limit,
                effort=effort,
                velocity=velocity,
                damping=0.5,
            )
        )


EFFORT = 20.0
"""Force of a jaw [N]; with more, round things creep out of the simulated jaws
(docs/notebook.md)."""


def add_gripper(model: Model) -> None:
    """The hand, 0.107 m beyond joint 7 and turned by 45 degrees, and two jaws of 4 cm of travel."""
    body = [
        (Shape("box", (0.063, 0.206, 0.075), (0, 0, 0.0285)), GREY),
        (Shape("cylinder", (0.035, 0.026), (0, 0, -0.013)), GREY),
        (Shape("box", (0.04, 0.05, 0.026), (0, -0.075, -0.013)), GREY),
    ]
    model.links.append(Link("panda_hand", 0.73, body))
    model.joints.append(
        Joint(
            "panda_hand_joint",
            "panda_link7",
            "panda_hand",
            (0, 0, 0.107),
            (0, 0, -math.pi / 4),
            kind="fixed",
        )
    )
    for name, side in (("leftfinger", 1), ("rightfinger", -1)):
        jaw = [
            (Shape("box", (0.022, 0.022, 0.020), (0, side * 0.0150, 0.011)), GREY),
            (Shape("box", (0.0175, 0.012, 0.022), (0, side * 0.0140, 0.0305)), GREY),
            (Shape("box", (0.0175, 0.0152, 0.0185), (0, side * 0.0076, 0.04525)), DARK),
        ]
        model.links.append(Link(f"panda_{name}", 0.015, jaw, primitives.rubber_friction(EFFORT)))
        model.joints.append(
            Joint(
                f"panda_finger_joint{1 if side > 0 else 2}",
                "panda_hand",
                f"panda_{name}",
                (0, 0, 0.0584),
                axis=(0, side, 0),
                limit=(0.0, 0.04),
                effort=EFFORT,
                velocity=0.05,
                damping=10.0,
                kind="prismatic",
                mimic="" if side > 0 else "panda_finger_joint1",
            )
        )


def build() -> Model:
    """The whole robot, arm first."""
    model = Model()
    add_arm(model)
    add_gripper(model)
    return model


if __name__ == "__main__":
    write_urdf(__file__, build(), COLOURS)
