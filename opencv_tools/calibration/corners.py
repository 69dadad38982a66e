# Copyright 2026 opencv_tools maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Positions of the corners of a board in an image, more precise than a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.boards import Board

Floats = NDArray[np.float64]

_NEIGHBOURS = 20  # corners that determine the map around a corner
_SAMPLES = (9, 41)  # least and most samples along each side of the window around a corner
_STEPS = 3
# An edge is followed up to this distance across it, in pixels or as a part of its length; it ends
# this number of pixels before a marker and before the other edge.
_ACROSS_PIXELS, _ACROSS_PART = 5.0, 0.3
_BLUR_PIXELS = 3.0
# Least part of the changes along the edges that are from black to white as on the board.
_LEAST_ORDER = 0.5
_LEAST_INSIDE = 0.6  # least part of the window that is inside of the image
_ROUNDS = 5  # of the search for further corners
_NEAR = 1.1  # pitches up to a corner that is searched for
_OUTLIER_PIXELS, _OUTLIER_MEDIANS = 0.5, 6.0

#: Least number of corners of a board in an image.
LEAST_CORNERS = 6


@dataclass(frozen=True)
class LocalMap:
    """
    Maps from the board to the image around some places of the board.

    :param positions: (k, 2) places in the image.
    :param linear: (k, 2, 2) pixels per metre: image axis by board axis.
    :param quadratic: (k, 3, 2) factors of x², x y and y² of the board.
    """

    positions: Floats
    linear: Floats
    quadratic: Floats

    def scale(self) -> Floats:
        """Return the pixels per metre at each place."""
        return np.sqrt(np.abs(np.linalg.det(self.linear)))


def fit_local_map(board: Floats, image: Floats, places: Floats, pitch: float) -> LocalMap:
    """
    Fit a map to the neighbours of each place; it contains perspective and distortion.

    :param board: (n, 2) places on the board in metres, not all on a line.
    :param image: (n, 2) their positions in the image.
    :param places: (k, 2) places on the board around which the maps are fitted.
    :param pitch: distance of the corners in metres.
    :returns: a map for each place.
    """
    away = np.linalg.norm(places[:, None] - board[None], axis=2) / pitch
    nearest = np.argsort(away, axis=1)[:, :_NEIGHBOURS]
    weights = np.exp(-np.take_along_axis(away, nearest, 1) ** 2 / 4)
    x, y = np.moveaxis((board[nearest] - places[:, None]) / pitch, 2, 0)
    # Without the cubic terms, corners at the edge of the board are wrong by 0.02 pixels.
    terms = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y,
                      x**3, x * x * y, x * y * y, y**3), axis=2)
    weighted = (terms * weights[..., None]).transpose(0, 2, 1)
    # Few neighbours determine no curvature. The small numbers keep it at 0 then.
    normal = weighted @ terms + np.diag([1e-9, 1e-6, 1e-6, *[0.05] * 7])
    factors = np.linalg.solve(normal, weighted @ image[nearest])
    return LocalMap(factors[:, 0], factors[:, 1:3].transpose(0, 2, 1) / pitch,
                    factors[:, 3:6] / pitch**2)


def corners_near(corners: Floats, places: Floats, pitch: float) -> NDArray[np.int64]:
    """Return the ids of the corners near some places, all (n, 2) in metres on the board."""
    away = np.linalg.norm(corners[:, None] - places[None], axis=2).min(axis=1)
    return np.flatnonzero(away < _NEAR * pitch)


@dataclass(frozen=True)
class FoundCorners:
    """
    Corners of a board in an image.

    :param ids: (n,) ids, ascending; empty if there are too few.
    :param positions: (n, 2) positions in pixels.
    :param edge_width: (n,) width of the edges in pixels.
    """

    ids: NDArray[np.int64]
    positions: Floats
    edge_width: Floats


def follow_corners(
    gray: NDArray[np.uint8], board: Board, ids: NDArray[np.int64], rough: Floats,
    is_fast: bool = False,
) -> FoundCorners:
    """
    Return all corners of a board that are connected to the first ones.

    Corners are also found beside markers that were not, because they are covered, blurred or cut.

    :param gray: (h, w) image.
    :param ids: (n,) ids of the first corners.
    :param rough: (n, 2) estimates of their positions.
    :param is_fast: whether only the first corners are refined.
    """
    places = board.corners()[:, :2].astype(float)
    nothing = FoundCorners(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0))
    limit, known = np.array(gray.shape[::-1]) - 2.0, 0
    for _ in range(_ROUNDS):
        inside = ((rough >= 1) & (rough <= limit)).all(axis=1)
        ids, rough = ids[inside], rough[inside]
        if _is_few(places[ids]):
            return nothing
        refined = refine_corners(gray, rough, places[ids], board)
        keep = np.flatnonzero(refined.is_corner)
        if not _is_few(places[ids[keep]]):
            keep = keep[_agrees(places[ids[keep]], refined.positions[keep], board.pitch)]
        if _is_few(places[ids[keep]]):
            return nothing
        found = FoundCorners(ids[keep], refined.positions[keep], refined.edge_width[keep])
        if is_fast:
            break
        around = corners_near(places, places[found.ids], board.pitch)
        maps = fit_local_map(places[found.ids], found.positions, places[around], board.pitch)
        if len(found.ids) == known:
            break
        # The next windows have the shape of the neighbours, whose places are better known now.
        ids, rough, known = around, maps.positions, len(found.ids)
    return found


def _is_few(places: Floats) -> bool:
    """Return whether places are too few, or on a line, which determines no pose."""
    return len(places) < LEAST_CORNERS or bool(
        np.linalg.matrix_rank(places - places[0], tol=1e-6) < 2)


def _agrees(places: Floats, positions: Floats, pitch: float) -> NDArray[np.bool_]:
    """Return which corners are where their neighbours expect them."""
    fitted = fit_local_map(places, positions, places, pitch)
    errors = np.linalg.norm(fitted.positions - positions, axis=1)
    limit = max(_OUTLIER_PIXELS, _OUTLIER_MEDIANS * float(np.median(errors)))
    return errors <= np.minimum(limit, np.maximum(0.1 * pitch * fitted.scale(), _OUTLIER_PIXELS))


@dataclass(frozen=True)
class RefinedCorners:
    """
    Corners after the refinement.

    :param positions: (n, 2) positions in pixels; 0 is the centre of the first pixel.
    :param is_corner: (n,) whether the image has a corner of the board there.
    :param edge_width: (n,) width of the edges in pixels from black to white.
    """

    positions: Floats
    is_corner: NDArray[np.bool_]
    edge_width: Floats


def refine_corners(
    gray: NDArray[np.uint8], corners: Floats, places: Floats, board: Board,
) -> RefinedCorners:
    """
    Move corners to the point where the two edges through them meet.

    The window around a corner has the shape of the board in the image, which is bent by the lens.
    It contains the edges of the squares only, not those of a marker. The place of an edge is the
    mean of the changes across it. Its noise is ten times less than that of
    ``cv2.cornerSubPix``, where the noise along an edge turns the edge.

    :param gray: (h, w) image.
    :param corners: (n, 2) estimates in pixels.
    :param places: (n, 2) places of these corners on the board in metres.
    :returns: corners in the same order.
    """
    around = fit_local_map(places, corners, places, board.pitch)
    scales = np.linalg.norm(around.linear, axis=1)  # pixels per metre of both axes
    half = board.reach * scales
    count = int(np.clip(2 * np.median(half) + 1, *_SAMPLES))
    axis = np.linspace(-board.reach, board.reach, count)
    flat = np.stack(np.meshgrid(axis, axis), axis=2).reshape(-1, 2)
    bent = np.stack((flat[:, 0]**2, flat[:, 0] * flat[:, 1], flat[:, 1]**2), axis=1)
    offsets = flat @ around.linear.transpose(0, 2, 1) + bent @ around.quadratic
    signs = _signs(axis, scales, board).astype(np.float32)
    height, width = gray.shape
    current = corners
    for _ in range(_STEPS):
        x, y = np.moveaxis(current[:, None] + offsets, 2, 0).astype(np.float32)
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        patches = cv2.remap(gray, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        squares = patches.reshape(-1, count, count).astype(np.float32)
        right, down = (np.asarray(np.gradient(squares, axis=one)) for one in (2, 1))
        changes = np.stack((right, down.transpose(0, 2, 1)), axis=1)
        seen = inside.reshape(-1, count, count)
        changes *= signs * np.stack((seen, seen.transpose(0, 2, 1)), axis=1)
        profile = changes.sum(axis=2)  # across each of the two edges
        total = profile.sum(axis=2)
        safe = np.where(np.abs(total) > 1e-6, total, 1.0)
        step = np.clip(profile @ axis / safe, -board.reach, board.reach)
        current = current + (around.linear @ step[..., None])[..., 0]
    order = np.abs(total) / np.maximum(np.abs(changes).sum(axis=(2, 3)), 1e-6)
    is_corner = ((total.prod(axis=1) > 0) & (order.min(axis=1) > _LEAST_ORDER)
                 & (inside.mean(axis=1) > _LEAST_INSIDE)
                 & (np.linalg.norm(current - corners, axis=1) < half.min(axis=1) / 2))
    samples = np.abs(safe) / np.maximum(np.abs(profile).max(axis=2), 1e-6)
    return RefinedCorners(current, is_corner, (samples * 2 * half / (count - 1)).max(axis=1))


def _signs(axis: Floats, scales: Floats, board: Board) -> Floats:
    """
    Return the signs of the changes across the edges of a corner, 0 beside the edges.

    :param axis: (c,) places of the samples along a side of the window in metres.
    :param scales: (k, 2) pixels per metre of the axes of the board at each corner.
    :returns: (k, 2, c, c) array: along the edge, across the edge. The first edge is along y.
    """
    half, margin = board.reach * scales, board.margin * scales
    wide = np.maximum(_ACROSS_PIXELS, _ACROSS_PART * half)
    if board.margin < board.reach:
        wide = np.minimum(wide, np.maximum(margin - _BLUR_PIXELS, 0.4 * margin))
    away = np.abs(axis) * scales[..., None]
    across = away <= wide[..., None]
    along = np.sign(axis) * (away > _BLUR_PIXELS)[:, ::-1]
    return along[..., None] * across[:, :, None]
