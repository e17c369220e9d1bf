"""Parameters of the contact simulation: step, iterations, friction, error correction."""

from __future__ import annotations

from dataclasses import dataclass

from pointsdf_cli.errors import InputError

JOINT_RECOVERY, CONTACT_RECOVERY = 96.0, 38.4
"""Correction rates [1/s] of position errors in joints and of overlaps in contacts.

PyBullet takes shares a step (these rates are its defaults, 0.2 and 0.08, at 1/480 s). Fixed shares
would make half the step a stiffer model, and a convergence study would compare two models.
"""


HAND_FRICTION, TABLE_FRICTION = 1.0, 0.8
"""Coefficients of lateral friction; those of two bodies multiply."""
ROLLING_FRICTION, SPINNING_FRICTION = 1e-4, 1e-3
"""Small coefficients of the object, for soft contacts."""
GRAVITY = 9.81
"""Gravity [m/s²]."""


@dataclass(frozen=True)
class PhysicsConfig:
    """Parameters of the contact simulation, chosen by the convergence study in docs/notebook.md.

    Attributes:
        step: Time step [s].
        iterations: Iterations of the contact solver in each step. With 40 and the whole arm,
            halving the step changes 9% of the labels, and objects of many pieces slip that are held
            with 200. With 200, halving the step changes 4%; moving the object by 0.1 mm, 3%.
        object_friction: Coefficient of lateral friction of the object.
        skin: Measured thickness [m] by which PyBullet inflates convex hulls and a URDF's cylinders;
            they are shrunk by it (`skin.py`). With 0 they stay inflated.
    """

    step: float = 1 / 480
    iterations: int = 200
    object_friction: float = 0.6
    skin: float = 1e-3

    def __post_init__(self) -> None:
        if not 1e-5 <= self.step <= 0.01 or not 1 <= self.iterations <= 10_000:
            what = f"a step of {self.step} s with {self.iterations} iterations"
            raise InputError(what, allowed="1e-5 to 0.01 s, 1 to 10000")
        if not 0.0 <= self.skin <= 0.01:
            raise InputError(f"a skin of {self.skin} m", allowed="0 to 0.01 m")
