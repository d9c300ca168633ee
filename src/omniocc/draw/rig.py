"""A rig on one image: from above, from the side, what its cameras share, and the road in every camera's image."""

import colorsys
import math
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.plausible import cross
from omniocc.draw.canvas import INK, PAPER, Rgb, blank, draw_label, draw_scale, draw_text, legend, text_width
from omniocc.draw.paint import rays_of_parts
from omniocc.draw.sheet import (
    azimuths,
    beside,
    camera_rows,
    column_width,
    elevations,
    inner_width,
    panorama_row,
    row,
    stack,
)

ASSUMED_ROAD_Z_M = -2.2
"""Height of the road in the ego frame that is drawn where it is not known: that of the virtual world."""
MAP_M, GRID_M = 10, 8
"""Half the edge of the map of the ground, and of the grid in the images, m."""
STEP_M = 0.05
"""Distance of the points by which a line of the grid is drawn."""
FAR_M = 1e5
"""Distance of the points of the horizon."""
DIRECTIONS = Equirectangular(360, 75, 30.0, -45.0)
DIRECTIONS_M = 20.0
"""Range at which it is counted how many cameras see a direction."""
ABOVE = torch.tensor([[1.0, 0, 0], [0, 1, 0]], dtype=torch.float64)
SIDE = torch.tensor([[0.0, 0, 1], [-1, 0, 0]], dtype=torch.float64)
"""What is up and left in the views from above and from the right side, as vectors of the ego frame."""
ORIGIN, AHEAD = torch.zeros(3, dtype=torch.float64), torch.tensor([1.0, 0, 0], dtype=torch.float64)
GREY, UNUSED = (150, 150, 150), 0.35
"""Grey of cameras without an image; brightness of pixels that lens or mask leave out."""
RED, GREEN, BLUE = (225, 30, 30), (20, 150, 60), (40, 90, 235)
HORIZON, GRID, PALE, WARNING = (255, 220, 0), (255, 0, 190), (225, 228, 232), (190, 40, 30)
COUNTS: tuple[tuple[str, Rgb], ...] = (
    ("seen by no camera", (70, 74, 82)),
    ("one", (244, 200, 130)),
    ("two", (140, 205, 140)),
    ("three", (80, 160, 210)),
    ("four or more", (110, 85, 185)),
)
GROUND: list[tuple[str, Rgb]] = [("horizon", HORIZON), ("road: metres", GRID), ("ahead and back (y = 0)", RED)]
GROUND += [("left and right (x = 0)", GREEN), ("dark: lens or mask leave it out", (60, 60, 60))]
AXES = [("a camera's right (x)", RED), ("down (y)", GREEN), ("forward (z)", BLUE)]


def rig_sheet(
    rig: Rig, images: Sequence[np.ndarray | None], findings: Sequence[str], caption: str, width_px: int = 1600
) -> np.ndarray:
    """Return the whole image.

    Args:
        rig: the cameras.
        images: (H, W, 3) uint8 RGB of every camera, of any size; None: a grey field.
        findings: lines below the caption, about what is suspicious.
        caption: first line.
        width_px: of the result.
    """
    road_z_m = ASSUMED_ROAD_Z_M if rig.road_z_m is None else rig.road_z_m
    inner = inner_width(width_px)
    third = column_width(inner, 3)
    state = "not known, drawn at" if rig.road_z_m is None else "at"
    panels = {
        "from above": view_along(rig, ABOVE, third, road_z_m),
        f"from the right side; road {state} z = {road_z_m:g} m": view_along(rig, SIDE, third, road_z_m),
        f"ground, {2 * MAP_M} m across: how many cameras see it": ground_map(rig, road_z_m, third),
    }
    directions = count_colors(counts(rig, DIRECTIONS.rays() * DIRECTIONS_M))
    columns = 2 if len(images) <= 4 else 3 if len(images) <= 9 else 5
    wide = column_width(inner, columns)
    views = [camera_view(rig, k, image, wide, road_z_m) for k, image in enumerate(images)]
    rows = [
        *_text(findings or ["nothing suspicious"], inner, WARNING if findings else GREEN),
        row(list(panels.values()), list(panels), inner),
        beside([legend(AXES, third * 2), legend([*COUNTS], third)], inner),
        panorama_row(directions, f"directions, {elevations(DIRECTIONS)}: how many cameras see them", inner),
        azimuths(inner),
        legend(GROUND, inner),
        *camera_rows(views, inner, columns, rig.names),
    ]
    return stack(rows, width_px, caption)


def counts(rig: Rig, points_ego: Tensor) -> Int64[np.ndarray, "..."]:
    """Return how many cameras see each point (..., 3), ego frame, m."""
    return rig.project(points_ego)[1].sum(0).numpy()


def count_colors(seen: np.ndarray) -> np.ndarray:
    """Return numbers of cameras in the colours of `COUNTS`, (..., 3) uint8."""
    return np.array([rgb for _, rgb in COUNTS], np.uint8)[np.minimum(seen, len(COUNTS) - 1)]


def ground_points(road_z_m: float, half_m: float, size: int) -> Float64[Tensor, "size size 3"]:
    """Return the middles of equal squares of the road around the origin, forward up, left to the left."""
    axis = half_m - (torch.arange(size, dtype=torch.float64) + 0.5) * (2 * half_m / size)
    x, y = torch.meshgrid(axis, axis, indexing="ij")
    return torch.stack([x, y, torch.full_like(x, road_z_m)], -1)


def ground_map(rig: Rig, road_z_m: float, size_px: int) -> np.ndarray:
    """Return a square map of how many cameras see the road, with the cameras on it."""
    colors = count_colors(counts(rig, ground_points(road_z_m, MAP_M, size_px // 2)))
    canvas = cv2.resize(colors, (size_px, size_px), interpolation=cv2.INTER_NEAREST)
    view = View(ABOVE, ORIGIN, MAP_M, size_px)
    view.arrow(canvas, 1.0, PAPER)
    for k, (u, v) in enumerate(view.places(rig.ego_from_camera[:, :3, 3]).tolist()):
        cv2.circle(canvas, (u, v), 5, camera_color(k), -1, cv2.LINE_AA)
        cv2.circle(canvas, (u, v), 5, PAPER, 1, cv2.LINE_AA)
    draw_scale(canvas, size_px / (2 * MAP_M))
    return canvas


class View(NamedTuple):
    """A square drawing without perspective.

    Attributes:
        look: what is up and what is left, ego frame.
        middle: point in the middle, ego frame, m.
        half_m: from the middle to the edges.
        size_px: edge.
    """

    look: Float64[Tensor, "2 3"]
    middle: Float64[Tensor, "3"]
    half_m: float
    size_px: int

    def places(self, points: Float64[Tensor, "P 3"]) -> Int64[np.ndarray, "P 2"]:
        """Return whole pixels (column, row) of ego points, m."""
        pixels = (self.half_m - (points - self.middle) @ self.look.T) * self.size_px / (2 * self.half_m) - 0.5
        return pixels.flip(-1).clamp(-1e4, 1e4).round().long().numpy()

    def line(self, canvas: np.ndarray, points: Float64[Tensor, "P 3"], rgb: Rgb, thickness: int = 1) -> None:
        """Draw a line through points in place."""
        cv2.polylines(canvas, [self.places(points).astype(np.int32)], False, rgb, thickness, cv2.LINE_AA)

    def arrow(self, canvas: np.ndarray, length_m: float, rgb: Rgb) -> tuple[int, int]:
        """Draw an arrow forward from the origin in place; return the pixel of the origin."""
        (u, v), (tip_u, tip_v) = self.places(torch.stack([ORIGIN, ORIGIN + length_m * AHEAD])).tolist()
        cv2.arrowedLine(canvas, (u, v), (tip_u, tip_v), rgb, 2, cv2.LINE_AA, tipLength=0.3)
        return u, v


def view_along(rig: Rig, look: Float64[Tensor, "2 3"], size_px: int, road_z_m: float) -> np.ndarray:
    """Return cameras, their axes and fields of view, seen in one direction; `look` is what is up and what is left."""
    positions = rig.ego_from_camera[:, :3, 3]
    shown = torch.cat([positions, torch.stack([ORIGIN, torch.tensor([0, 0, road_z_m])])])
    low, high = shown.amin(0), shown.amax(0)
    half_m = float((high - low).max()) / 2 * 1.3 + 1.5
    view, canvas = View(look, (low + high) / 2, half_m, size_px), blank(size_px, size_px)
    step_m = 10 ** max(0, math.ceil(math.log10(half_m / 30)))  # positions in mm give a rig of kilometres
    for along, across in (look, look.flip(0)):
        middle, far = float(along @ view.middle), across * (across @ view.middle)
        for number in range(math.ceil((middle - half_m) / step_m), math.floor((middle + half_m) / step_m) + 1):
            start = along * number * step_m + far
            view.line(canvas, torch.stack([start - 2 * half_m * across, start + 2 * half_m * across]), PALE)
    for k, pose in enumerate(rig.ego_from_camera):
        _, rays, seen = cross(rig.cameras[k])[0 if look is ABOVE else 1]
        edge = rays[seen][::8] @ pose[:3, :3].T
        if look is ABOVE:  # as wide as it is, whatever the pitch
            edge = edge / (edge @ look.T).norm(dim=-1, keepdim=True).clamp(min=1e-3)
        fan = torch.cat([pose[None, :3, 3], pose[:3, 3] + edge * half_m / 3, pose[None, :3, 3]])
        covered = cv2.fillPoly(canvas.copy(), [view.places(fan).astype(np.int32)], camera_color(k))
        canvas = np.asarray(cv2.addWeighted(canvas, 0.82, covered, 0.18, 0))
        view.line(canvas, fan, camera_color(k))
    if look is not ABOVE:
        view.line(canvas, torch.tensor([[-5 * half_m, 0, road_z_m], [5 * half_m, 0, road_z_m]]), (120, 120, 120), 3)
    u, v = view.arrow(canvas, half_m / 5, INK)
    draw_text(canvas, "forward", u - 20, v + 16, 9)
    for k, pose in enumerate(rig.ego_from_camera):
        for axis, rgb in enumerate((RED, GREEN, BLUE)):
            view.line(canvas, torch.stack([pose[:3, 3], pose[:3, 3] + pose[:3, axis] * half_m / 9]), rgb, 2)
        name_at = pose[:3, 3] + pose[:3, 2] / pose[:2, 2].norm().clamp(min=0.2) * half_m / 4.5
        (u, v), (left, row) = view.places(torch.stack([pose[:3, 3], name_at])).tolist()
        cv2.circle(canvas, (u, v), 5, camera_color(k), -1, cv2.LINE_AA)
        if look is ABOVE:
            draw_text(canvas, rig.names[k], left - text_width(rig.names[k], 10) // 2, row + 5, 10)
    draw_label(canvas, f"lines: {step_m} m", 8, size_px - 32)
    return canvas


def camera_view(rig: Rig, k: int, image: np.ndarray | None, width_px: int, road_z_m: float) -> np.ndarray:
    """Return a camera's image, or a grey field, at a width, with horizon and road; dark where nothing is used."""
    camera = rig.cameras[k]
    height_px = round(camera.height * width_px / camera.width)
    canvas = blank(width_px, height_px, GREY)
    if image is not None:
        canvas = cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA)
    _, seen = rays_of_parts(rig, k, width_px, height_px)
    canvas = np.where(seen.numpy()[..., None], canvas, (canvas * UNUSED).astype(np.uint8))
    scale = width_px / camera.width
    lines = canvas.copy()
    for points, color, thickness in [*ground_lines(road_z_m), (horizon(rig, k), HORIZON, 2)]:
        pixels, valid = rig.project_into(k, points)
        draw_line(lines, ((pixels + 0.5) * scale - 0.5).numpy(), valid.numpy(), color, thickness)
    canvas = cv2.addWeighted(canvas, 0.3, lines, 0.7, 0)
    for text, x, y in (("5 m ahead", 5, 0), ("5 m left", 0, 5), ("5 m back", -5, 0), ("5 m right", 0, -5)):
        pixel, valid = rig.project_into(k, torch.tensor([x, y, road_z_m], dtype=torch.float64))
        if bool(valid):
            u, v = ((pixel + 0.5) * scale - 0.5).round().int().tolist()
            cv2.circle(canvas, (u, v), 4, (255, 255, 255), -1, cv2.LINE_AA)
            left = min(u + 6, width_px - text_width(text, 9) - 14)
            draw_label(canvas, text, max(left, 0), max(min(v - 10, height_px - 24), 0), 9)
    cv2.rectangle(canvas, (0, 0), (width_px - 1, height_px - 1), camera_color(k), 7)
    return canvas


def ground_lines(road_z_m: float) -> list[tuple[Float64[Tensor, "S 3"], Rgb, int]]:
    """Return the lines of the road's grid, one a metre, with colour and thickness; the axes come last."""
    lines = []
    steps = torch.arange(-GRID_M, GRID_M + STEP_M / 2, STEP_M, dtype=torch.float64)
    for metre in sorted(range(-GRID_M, GRID_M + 1), key=abs, reverse=True):
        fixed, z = torch.full_like(steps, metre), torch.full_like(steps, road_z_m)
        lines.append((torch.stack([steps, fixed, z], -1), GRID if metre else RED, 1 if metre else 2))
        lines.append((torch.stack([fixed, steps, z], -1), GRID if metre else GREEN, 1 if metre else 2))
    return lines


def horizon(rig: Rig, k: int) -> Float64[Tensor, "S 3"]:
    """Return points at the height of a camera, far away and all around it, ego frame, m."""
    angles = torch.linspace(0, 2 * torch.pi, 1441, dtype=torch.float64)
    return rig.ego_from_camera[k, :3, 3] + FAR_M * torch.stack([angles.cos(), angles.sin(), 0 * angles], -1)


def draw_line(canvas: np.ndarray, places: np.ndarray, valid: np.ndarray, rgb: Rgb, thickness: int) -> None:
    """Draw the visible parts of a line through pixels (S, 2) in place; it is interrupted where a panorama begins."""
    jumps = np.abs(np.diff(places[:, 0])) > canvas.shape[1] / 4
    joined = valid[1:] & valid[:-1] & ~jumps
    for run in np.split(np.arange(len(places)), np.flatnonzero(~joined) + 1):
        if len(run) > 1:
            fixed = np.round(places[run] * 16).astype(np.int32)
            cv2.polylines(canvas, [fixed], False, rgb, thickness, cv2.LINE_AA, shift=4)


def camera_color(k: int) -> Rgb:
    """Return the colour of a camera; those of neighbours in the file differ most."""
    red, green, blue = colorsys.hsv_to_rgb((0.58 + 0.382 * k) % 1, 0.75, 0.8)
    return round(255 * red), round(255 * green), round(255 * blue)


def _text(lines: Sequence[str], width: int, rgb: Rgb) -> list[np.ndarray]:
    """Return lines of text, broken where they are longer than a width."""
    rows = []
    for line in lines:
        for part in textwrap.wrap(line, width * len(line) // max(text_width(line, 10), 1)):
            rows.append(blank(width, 16))
            draw_text(rows[-1], part, 0, 12, 10, rgb)
    return rows
