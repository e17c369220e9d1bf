"""Writes ur5e_2f85.urdf: Universal Robots UR5e with a Robotiq 2F-85, from primitives only.

Run it after a change of any number here: `python assets/robots/make_ur5e_2f85.py`. Lengths, masses,
efforts and speeds of the arm are those of the maker's pages ("DH parameters for calculations of
kinematics and dynamics", "Max. joint torques") and, with frames and names, of its URDF; its joints
turn by half a turn each way here, though most of the real ones turn by a whole one. Frames and
joint names of the gripper are those of the ROS-Industrial URDF, whose fixed links are joined here.
Its pads stay parallel: that it also encloses what touches the fingers behind them is not modelled.
Shapes are primitives; no link of the makers' meshes stands out by more than 5 mm.
"""

from __future__ import annotations

import math

from primitives import Joint, Link, Model, Shape, drum, rubber_friction, tube, write_urdf

LIGHT, GREY, BLUE, DARK = "ur_light", "ur_grey", "ur_blue", "gripper_dark"
COLOURS = {
    LIGHT: "0.82 0.83 0.85 1",
    GREY: "0.45 0.46 0.48 1",
    BLUE: "0.49 0.68 0.80 1",
    DARK: "0.15 0.15 0.16 1",
}
QUARTER = math.pi / 2
UPPER, FORE = 0.425, 0.3922
"""Lengths of upper arm and forearm (a2, a3) [m]."""


def box(
    size: tuple[float, float, float], centre: tuple[float, float, float], roll: float = 0.0
) -> Shape:
    """A box, turned about x."""
    return Shape("box", size, centre, (roll, 0, 0))


def add_arm(model: Model) -> None:
    """Six links on a base; each joint's housing sits beside the next."""
    parts = {
        "base_link": (4.0, [(tube(0.0755, 0, 0.0991), GREY)]),
        "shoulder_link": (
            3.761,
            [
                (tube(0.06, -0.064, 0.066), LIGHT),
                (drum(0.06, -0.0744, -0.02), BLUE),
                (box((0.109, 0.07, 0.132), (0, -0.035, 0.004)), BLUE),
            ],
        ),
        "upper_arm_link": (
            8.058,
            [
                (tube(0.0605, 0.071, 0.21), BLUE),
                (tube(0.0605, 0.060, 0.21, -UPPER), BLUE),
                (box((UPPER, 0.119, 0.145), (-UPPER / 2, 0, 0.1345)), LIGHT),
            ],
        ),
        "forearm_link": (
            2.846,
            [
                (tube(0.058, -0.002, 0.0604), BLUE),
                (tube(0.047, -0.027, 0), BLUE),
                (tube(0.0395, -0.0495, 0.0604, -FORE), BLUE),
                (box((0.2, 0.088, 0.104), (-0.292, 0, 0.006)), LIGHT),
                (box((0.182, 0.104, 0.1), (-0.109, 0, 0.01)), LIGHT),
            ],
        ),
        "wrist_1_link": (
            1.37,
            [
                (tube(0.039, -0.0736, 0), LIGHT),
                (drum(0.039, -0.0536, 0.0563), BLUE),
                (box((0.07, 0.092, 0.042), (0, 0, -0.035)), BLUE),
            ],
        ),
        "wrist_2_link": (
            1.3,
            [
                (tube(0.039, -0.0461, 0), LIGHT),
                (drum(0.039, -0.0567, 0.0531), BLUE),
                (box((0.07, 0.1, 0.034), (0, -0.002, -0.021)), BLUE),
            ],
        ),
        "wrist_3_link": (
            0.365,
            [
                (tube(0.0376, -0.0458, 0), GREY),
                (box((0.029, 0.016, 0.039), (0, -0.0355, -0.0265)), GREY),
            ],
        ),
    }  # fmt: skip
    model.links += [Link(name, mass, shapes) for name, (mass, shapes) in parts.items()]
    strong, weak = 150.0, 28.0
    rows = [  # joint, origin, rpy, effort
        ("shoulder_pan", (0, 0, 0.1625), (0, 0, math.pi), strong),
        ("shoulder_lift", (0, 0, 0), (QUARTER, 0, 0), strong),
        ("elbow", (-UPPER, 0, 0), (0, 0, 0), strong),
        ("wrist_1", (-FORE, 0, 0.1333), (0, 0, 0), weak),
        ("wrist_2", (0, -0.0997, 0), (QUARTER, 0, 0), weak),
        ("wrist_3", (0, 0.0996, 0), (QUARTER, math.pi, math.pi), weak),
    ]
    links = list(parts)
    for (name, xyz, rpy, effort), parent, child in zip(rows, links, links[1:], strict=False):
        limit = (-math.pi, math.pi)
        model.joints.append(
            Joint(
                f"{name}_joint",
                parent,
                child,
                xyz,
                rpy,
                limit=limit,
                effort=effort,
                velocity=math.pi,
                damping=0.5,
            )
        )


CLOSED = 0.81
"""Angle of the knuckles at which the pads meet [rad]."""
COUPLING = 0.011
"""Gripper's frame above the arm's flange: the coupling is 13.9 mm high [m]."""
FORCE = 20.0
"""Force of a pad [N], the least of the real gripper; with more, round things creep out of the
simulated jaws (docs/notebook.md)."""
LEVER = 0.05
"""Way of a pad for a turn of its knuckle, 43 to 57 mm a radian [m]."""


def add_gripper(model: Model) -> None:
    """The gripper's body, and two fingers of three links each; the pads stay parallel."""
    body = [
        tube(0.0385, -0.0139, 0.034),
        box((0.066, 0.083, 0.03), (0, 0, 0.038)),
        box((0.046, 0.08, 0.02), (0, 0, 0.061)),
        box((0.032, 0.058, 0.02), (0, 0, 0.08)),
    ]
    model.links.append(Link("robotiq_arg2f_base_link", 0.78, [(shape, DARK) for shape in body]))
    model.joints.append(
        Joint(
            "gripper_mount",
            "wrist_3_link",
            "robotiq_arg2f_base_link",
            (0, 0, COUPLING),
            kind="fixed",
        )
    )
    for side, sign in (("left", -1), ("right", 1)):
        add_finger(model, side, sign)


def add_finger(model: Model, side: str, sign: int) -> None:
    """The finger at y = `sign` times its distance from the middle, which closes towards it."""
    base, leader = "robotiq_arg2f_base_link", "finger_joint"
    knuckle = [  # y outwards, z along the gripper
        (box((0.022, 0.046, 0.021), (0, 0.0155, 0.001)), GREY),
        (box((0.027, 0.012, 0.058), (0, 0.0345, 0.0194), -0.13), DARK),
    ]
    finger = [
        (box((0.015, 0.025, 0.017), (0, -0.0085, 0.003)), DARK),
        (box((0.015, 0.018, 0.034), (0, -0.0145, 0.028)), DARK),
        (box((0.022, 0.00635, 0.0375), (0, -0.02202, 0.03242)), GREY),
    ]
    strut = [(box((0.036, 0.0145, 0.066), (0, 0.0185, 0.0215), -QUARTER / 2), DARK)]
    away = (0, 0, math.pi if sign < 0 else 0)
    rows = [  # parent, link, joint's frame, angle of a turn of `finger_joint` by 1 rad
        (base, "outer_knuckle", (0, sign * 0.0306011, 0.054904), away, 1),
        (f"{side}_outer_knuckle", "inner_finger", (0, 0.0376, 0.043), (0, 0, 0), -1),
        (base, "inner_knuckle", (0, sign * 0.0127, 0.06142), away, 1),
    ]
    for (parent, name, xyz, rpy, angle), parts in zip(rows, (knuckle, finger, strut), strict=True):
        link, driven = f"{side}_{name}", name == "outer_knuckle"
        soft = rubber_friction(FORCE) if name == "inner_finger" else 0.0
        joint = leader if link == "left_outer_knuckle" else f"{link}_joint"
        model.links.append(Link(link, 0.03, parts, soft))
        model.joints.append(
            Joint(
                joint,
                parent,
                link,
                xyz,
                rpy,
                axis=(1, 0, 0),
                limit=(0.0, CLOSED) if angle > 0 else (-CLOSED, 0.0),
                effort=FORCE * LEVER if driven else 0.02,
                velocity=1.4,
                damping=0.02,
                mimic="" if joint == leader else leader,
                multiplier=angle,
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
