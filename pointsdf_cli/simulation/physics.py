"""The numbers of the contact simulation: step, iterations, friction, how errors are taken back."""

from __future__ import annotations

from dataclasses import dataclass

from pointsdf_cli.errors import InputError

JOINT_RECOVERY, CONTACT_RECOVERY = 96.0, 38.4
"""Correction rates [1/s] of position errors in joints and of overlaps in contacts.

PyBullet asks for the share a step (these are its defaults, 0.2 and 0.08, at 1/480 s), with which
half the step would be another, stiffer model, and a study of the step would compare the two.
"""


@dataclass(frozen=True)
class PhysicsConfig:
    """Numbers of the contact simulation, chosen by the convergence study in docs/notebook.md.

    Attributes:
        step: Time step [s].
        iterations: Iterations of the contact solver in each step. For the whole arm with 40, half
            the step changes 9% of labels, and objects of many pieces slip that hold with 200; with
            200, half the step changes 4%, and moving the object by 0.1 mm 3%.
        hand_friction, object_friction, table_friction: Lateral; two bodies' values multiply.
        rolling_friction, spinning_friction: Friction of the object, small: soft contacts resist a
            little.
        gravity: [m/s²].
        skin: Thickness [m], measured, by which PyBullet inflates convex hulls, and a URDF's
            cylinders; they are drawn in by it (`skin.py`). With 0 they stand out.
    """

    step: float = 1 / 480
    iterations: int = 200
    hand_friction: float = 1.0
    object_friction: float = 0.6
    table_friction: float = 0.8
    rolling_friction: float = 1e-4
    spinning_friction: float = 1e-3
    gravity: float = 9.81
    skin: float = 1e-3

    def __post_init__(self) -> None:
        if not 1e-5 <= self.step <= 0.01 or not 1 <= self.iterations <= 10_000:
            raise InputError(
                f"a step of {self.step} s with {self.iterations} iterations",
                allowed="1e-5 to 0.01 s, 1 to 10000",
            )
        if not 0.0 <= self.skin <= 0.01:
            raise InputError(f"a skin of {self.skin} m", allowed="0 to 0.01 m")
