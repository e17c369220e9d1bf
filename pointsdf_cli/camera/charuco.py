"""ChArUco boards: drawn to scale, and found in images (OpenCV)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.choices import Dictionary, require_choice
from pointsdf_cli.errors import InputError

BITS, SIZES = (4, 5, 6, 7), (50, 100, 250, 1000)
FEWEST_CORNERS = 6
MOST_SQUARES = 40


@dataclass(frozen=True)
class CharucoBoard:
    """A chessboard with an ArUco marker in every white square.

    Attributes:
        columns, rows: Squares along x and along y.
        square: Side of a square [m].
        marker: Side of a marker [m].
        dictionary: One of `choices.Dictionary`.
        legacy: The pattern of OpenCV before 4.6, which differs for even numbers of rows.

    Raises:
        InputError: A value is out of its range, or the dictionary has too few markers.
    """

    columns: int = 5
    rows: int = 7
    square: float = 0.035
    marker: float = 0.026
    dictionary: str = "5X5_100"
    legacy: bool = False

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= MOST_SQUARES and 3 <= self.rows <= MOST_SQUARES):
            raise InputError(
                f"a board of {self.columns} × {self.rows} squares",
                where="--squares",
                allowed=f"3 to {MOST_SQUARES} each, such as 5x7",
            )
        if not 0.002 <= self.square <= 0.5:
            raise InputError(
                f"squares of {self.square:g} m", where="--square", allowed="0.002 to 0.5 m"
            )
        if not 0.3 * self.square <= self.marker < self.square:
            what = f"markers of {self.marker:g} m in squares of {self.square:g} m"
            raise InputError(what, where="--marker", allowed="0.3 to 1 times the square's side [m]")
        require_choice(self.dictionary, Dictionary, "--dictionary")
        size, markers = int(self.dictionary.split("_")[1]), self.columns * self.rows // 2
        if markers > size:
            raise InputError(
                f"a board of {self.columns} × {self.rows} squares has {markers} markers, and "
                f"{self.dictionary} has {size}",
                where="--dictionary",
                allowed="a larger dictionary",
            )

    @property
    def corners(self) -> NDArray[np.float64]:
        """The inner corners [N, 3] of the chessboard in the board's frame [m], z = 0."""
        return np.asarray(self.opencv().getChessboardCorners(), dtype=np.float64)

    def opencv(self) -> Any:
        """The board as OpenCV's CharucoBoard."""
        import cv2

        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, known)
        board.setLegacyPattern(self.legacy)
        return board

    def __str__(self) -> str:
        return (
            f"{self.columns} × {self.rows} squares of {1000 * self.square:g} mm, markers of "
            f"{1000 * self.marker:g} mm, {self.dictionary}"
        )


class BoardView(NamedTuple):
    """Corners of a board in one image.

    `ids` [N] index `CharucoBoard.corners`; `pixels` [N, 2] are (u, v).
    """

    ids: NDArray[np.int64]
    pixels: NDArray[np.float64]


def find_board(image: NDArray[np.uint8], board: CharucoBoard) -> BoardView | None:
    """The corners of a board in a grey image [height, width]; None for fewer than
    `FEWEST_CORNERS`, or corners all on one line."""
    import cv2

    pixels, ids, _, _ = cv2.aruco.CharucoDetector(board.opencv()).detectBoard(image)
    if ids is None or len(ids) < FEWEST_CORNERS:
        return None
    ids = np.asarray(ids, dtype=np.int64).ravel()
    rows, columns = np.divmod(ids, board.columns - 1)
    if len(np.unique(rows)) < 2 or len(np.unique(columns)) < 2:
        return None
    return BoardView(ids, np.asarray(pixels, dtype=np.float64).reshape(-1, 2))


def without_distortion(view: BoardView, camera: Camera, coefficients: Sequence[float]) -> BoardView:
    """Undistort the corners.

    Args:
        view: Corners as found.
        camera: Intrinsics.
        coefficients: OpenCV's distortion coefficients; none leaves the corners unchanged.
    """
    if not len(coefficients):
        return view
    import cv2

    lens, still, pixels = np.asarray(coefficients), np.zeros(3), view.pixels.copy()
    for _ in range(30):  # fixed point: ideal pixels that distort to those found
        rays = camera.back_project(pixels[:, 0], pixels[:, 1], 1.0)
        bent = cv2.projectPoints(rays, still, still, camera.K, lens)[0].reshape(-1, 2)
        pixels = pixels + view.pixels - bent
    return view._replace(pixels=pixels)


def draw_board(board: CharucoBoard, per_square: int, margin: int) -> NDArray[np.uint8]:
    """The board as an image u1 of `per_square` pixels a square, with a white margin [px]."""
    size = (board.columns * per_square + 2 * margin, board.rows * per_square + 2 * margin)
    return np.asarray(board.opencv().generateImage(size, marginSize=margin, borderBits=1))


def why_not_found(images: Sequence[NDArray[np.uint8]], board: CharucoBoard) -> str | None:
    """Advice on how to describe the board so that it is found in one of the images, or None.

    Args:
        images: Grey images [height, width] in which `find_board` found nothing.
        board: Expected board.
    """
    for image in images:
        if find_board(np.ascontiguousarray(image[:, ::-1]), board):
            return "the images are mirrored: save them as the camera gives them"
        if find_board(image, replace(board, legacy=not board.legacy)):
            way = "leave out" if board.legacy else "add"
            return f"{way} --legacy-board (OpenCV changed the pattern of boards in 4.6)"
        turned = replace(board, columns=board.rows, rows=board.columns)
        if find_board(image, turned):
            return f"--squares {turned.columns}x{turned.rows}"
        kind, ids = _markers_seen(image)
        if kind and not board.dictionary.startswith(f"{kind}_"):
            size = next(size for size in SIZES if ids.max() < size)
            return f"--dictionary {kind}_{size}: its markers are in the images"
        if kind:
            return (
                f"--squares: markers of this dictionary up to number {ids.max()} are in the "
                f"images, as on a board of {2 * ids.max() + 2} squares or one more"
            )
    return None


def _markers_seen(image: NDArray[np.uint8]) -> tuple[str, NDArray[np.int64]]:
    """The kind of dictionary (such as 5X5) of which most markers are in an image, and their
    numbers; none for fewer than three."""
    import cv2

    found: dict[str, NDArray[np.int64]] = {}
    for bits in BITS:  # smaller dictionaries hold the first markers of the largest
        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{bits}X{bits}_1000"))
        _, ids, _ = cv2.aruco.ArucoDetector(known).detectMarkers(image)
        found[f"{bits}X{bits}"] = np.array([] if ids is None else np.ravel(ids), np.int64)
    best = max(found, key=lambda kind: len(found[kind]))
    return (best, found[best]) if len(found[best]) >= 3 else ("", found[best])
