"""Writes lbr4_allegro.urdf: KUKA LBR4 with a right Allegro hand, from primitives only.

Run it after a change of any number here: `python assets/robots/make_lbr4_allegro.py`.
"""

from __future__ import annotations

import math

from primitives import Joint, Link, Model, Shape, write_urdf

ORANGE, GREY, DARK, WHITE = "kuka_orange", "kuka_grey", "hand_dark", "tip_white"
COLOURS = {
    ORANGE: "0.92 0.45 0.12 1",
    GREY: "0.62 0.64 0.66 1",
    DARK: "0.22 0.23 0.26 1",
    WHITE: "0.93 0.93 0.90 1",
}


def capsule(radius: float, start: float, end: float) -> list[tuple[Shape, str]]:
    """A cylinder along z from start to end with a ball at its far end."""
    body = Shape("cylinder", (radius, end - start), (0, 0, (start + end) / 2))
    return [(body, ORANGE), (Shape("sphere", (radius,), (0, 0, end)), GREY)]


def add_arm(model: Model) -> None:
    """LBR4: eight links, ball-ended tubes from one joint to the next."""
    base = [(Shape("cylinder", (0.075, 0.11), (0, 0, 0.055)), GREY)]
    links = [
        Link("lbr4_link_0", 2.7, base),
        Link("lbr4_link_1", 2.7, capsule(0.065, 0.0, 0.2005)),
        Link("lbr4_link_2", 2.7, capsule(0.065, 0.06, 0.20)),
        Link("lbr4_link_3", 2.7, capsule(0.065, 0.0, 0.20)),
        Link("lbr4_link_4", 2.7, capsule(0.06, 0.06, 0.20)),
        Link("lbr4_link_5", 1.7, capsule(0.055, 0.0, 0.19)),
        Link("lbr4_link_6", 1.6, [(Shape("cylinder", (0.045, 0.057), (0, 0, 0.0285)), ORANGE)]),
        # The flange, and the adapter that carries the hand.
        Link("lbr4_link_7", 0.5, [(Shape("cylinder", (0.04, 0.035), (0, 0, -0.0025)), GREY)]),
    ]
    degree = math.pi / 180
    rows = [  # origin z, axis, limit, effort, velocity
        (0.11, (0, 0, 1), 170, 176, 110),
        (0.2005, (0, -1, 0), 120, 176, 110),
        (0.20, (0, 0, 1), 170, 100, 128),
        (0.20, (0, 1, 0), 120, 100, 128),
        (0.20, (0, 0, 1), 170, 100, 204),
        (0.19, (0, -1, 0), 120, 38, 184),
        (0.078, (0, 0, 1), 170, 38, 184),
    ]
    model.links += links
    for i, (z, axis, limit, effort, velocity) in enumerate(rows):
        bound = limit * degree
        model.joints.append(
            Joint(
                f"lbr4_joint_{i + 1}",
                f"lbr4_link_{i}",
                f"lbr4_link_{i + 1}",
                (0, 0, z),
                axis=axis,
                limit=(-bound, bound),
                effort=effort,
                velocity=velocity * degree,
                damping=0.5,
            )
        )


def add_palm(model: Model) -> None:
    """The palm, 0.015 m of adapter and 0.095 m of body above the flange, fingers along its z."""
    boxes = [
        Shape("box", (0.0414, 0.112, 0.0448), (-0.0093, 0, -0.0224)),
        Shape("box", (0.0414, 0.0538, 0.0428), (-0.0093, -0.0253, -0.0667)),
        Shape("box", (0.0414, 0.072, 0.013), (-0.0093, -0.0056, -0.0887)),
    ]
    model.links.append(Link("allegro_palm", 0.415, [(box, DARK) for box in boxes]))
    model.joints.append(
        Joint("allegro_mount", "lbr4_link_7", "allegro_palm", (0, 0, 0.11), kind="fixed")
    )


def box_link(name: str, mass: float, size: tuple[float, ...], centre: tuple[float, ...]) -> Link:
    return Link(name, mass, [(Shape("box", size, tuple(centre)), DARK)])


def tip_link(name: str, mass: float, length: float) -> Link:
    """A last finger link: its box and the soft ball at its end."""
    box = Shape("box", (0.0196, 0.0275, length), (0, 0, length / 2))
    return Link(name, mass, [(box, DARK), (Shape("sphere", (0.012,), (0, 0, length)), WHITE)])


HAND = {"effort": 0.7, "velocity": 7.0, "damping": 0.01}


def add_finger(
    model: Model,
    name: str,
    xyz: tuple[float, float, float],
    rpy: tuple[float, float, float],
) -> None:
    """Index, middle or ring: abduction about z, then three flexions about y."""
    model.links += [
        box_link(f"{name}_link_0", 0.0119, (0.0196, 0.0275, 0.0164), (0, 0, 0.0082)),
        box_link(f"{name}_link_1", 0.065, (0.0196, 0.0275, 0.054), (0, 0, 0.027)),
        box_link(f"{name}_link_2", 0.0355, (0.0196, 0.0275, 0.0384), (0, 0, 0.0192)),
        tip_link(f"{name}_link_3", 0.03, 0.0267),
    ]
    rows = [  # parent, origin, rpy, axis, limit
        ("allegro_palm", xyz, rpy, (0, 0, 1), (-0.47, 0.47)),
        (f"{name}_link_0", (0, 0, 0.0164), (0, 0, 0), (0, 1, 0), (-0.196, 1.61)),
        (f"{name}_link_1", (0, 0, 0.054), (0, 0, 0), (0, 1, 0), (-0.174, 1.709)),
        (f"{name}_link_2", (0, 0, 0.0384), (0, 0, 0), (0, 1, 0), (-0.227, 1.618)),
    ]
    for i, (parent, origin, turn, axis, limit) in enumerate(rows):
        model.joints.append(
            Joint(
                f"{name}_joint_{i}", parent, f"{name}_link_{i}", origin, turn, axis, limit, **HAND
            )
        )


def add_thumb(model: Model) -> None:
    """The thumb: opposition about -x, rotation about z, then two flexions about y."""
    model.links += [
        box_link("thumb_link_0", 0.0176, (0.0358, 0.034, 0.0455), (-0.0179, 0.009, 0.0145)),
        box_link("thumb_link_1", 0.0119, (0.0196, 0.0275, 0.0177), (0, 0, 0.00885)),
        box_link("thumb_link_2", 0.038, (0.0196, 0.0275, 0.0514), (0, 0, 0.0257)),
        tip_link("thumb_link_3", 0.0388, 0.0423),
    ]
    seat = (-0.0182, 0.019333, -0.045987)
    turn = (0.0, -1.658063, -1.570796)
    rows = [
        ("allegro_palm", seat, turn, (-1, 0, 0), (0.263, 1.396)),
        ("thumb_link_0", (-0.027, 0.005, 0.0399), (0, 0, 0), (0, 0, 1), (-0.105, 1.163)),
        ("thumb_link_1", (0, 0, 0.0177), (0, 0, 0), (0, 1, 0), (-0.189, 1.644)),
        ("thumb_link_2", (0, 0, 0.0514), (0, 0, 0), (0, 1, 0), (-0.162, 1.719)),
    ]
    for i, (parent, origin, rpy, axis, limit) in enumerate(rows):
        model.joints.append(
            Joint(f"thumb_joint_{i}", parent, f"thumb_link_{i}", origin, rpy, axis, limit, **HAND)
        )


def build() -> Model:
    """The whole robot, arm first and thumb last."""
    model = Model()
    add_arm(model)
    add_palm(model)
    add_finger(model, "index", (0, 0.0435, -0.001542), (-0.0872665, 0, 0))
    add_finger(model, "middle", (0, 0, 0.0007), (0, 0, 0))
    add_finger(model, "ring", (0, -0.0435, -0.001542), (0.0872665, 0, 0))
    add_thumb(model)
    return model


if __name__ == "__main__":
    write_urdf(__file__, build(), COLOURS)
