"""Objects along a street: plots behind the sidewalk, furniture on it, parked cars beside it."""

from bisect import bisect_right
from collections.abc import Iterator
from math import atan2

import numpy as np

from omniocc.seeding import choice, weighted_choice
from omniworld.assets import prop, tree, vehicle
from omniworld.assets.barrier import PIECE_M
from omniworld.assets.catalog import random_variant
from omniworld.mesh.material import Material
from omniworld.mesh.shape import Number
from omniworld.town import plot
from omniworld.town.line import interpolate
from omniworld.town.marking import CROSSING_M
from omniworld.town.network import Network, Ring, Side, degrees
from omniworld.town.site import Plan, Pose2, Signal, Site
from omniworld.town.theme import Theme

_STREET_TREES = ("round", "tall", "birch", "young")


def furniture_m(theme: Theme) -> float:
    """Return the width of the strip beside the kerb for furniture; walkers use the rest of the sidewalk."""
    return min(1.3, 0.38 * theme.sidewalk_m)


def reserve(theme: Theme, network: Network, plan: Plan) -> None:
    """Take streets and sidewalks from the free land."""
    for ring in network.rings:
        closed = [np.concatenate([points, points[:1]]) for points in (ring.kerb_m, ring.normal, ring.inner_m)]
        fine = np.arange(0, len(ring.kerb_m), 0.1)
        kerb, normal, inner = (interpolate(fine, np.arange(len(points)), points) for points in closed)
        for fraction in np.linspace(0, 1, 28):
            plan.block(kerb + fraction * (inner - kerb))
        for offset in np.arange(0, theme.sidewalk_m + 0.01, 0.25):
            plan.block(kerb + offset * normal)


class _Line:
    """Poses along one side of a block: x along the ring, y into the block, from the kerb."""

    def __init__(self, side: Side) -> None:
        self.side = side
        self._along, self._points = side.along_m.tolist(), side.kerb_m.tolist()

    def at(self, along_m: Number, into_block_m: Number, yaw_rad: Number = 0.0) -> Pose2:
        """Return the pose at a distance along the side."""
        (ax, ay), (bx, by) = self._point(along_m - 0.5), self._point(along_m + 0.5)
        return Pose2(0.5 * (ax + bx), 0.5 * (ay + by), atan2(by - ay, bx - ax)).at(0, into_block_m, yaw_rad)

    def front(self, along_m: Number, into_block_m: Number) -> Pose2:
        """Return the pose of a plot's front edge; past the ends of the side it goes straight on."""
        inside = min(max(float(along_m), self._along[0] + 0.5), self._along[-1] - 0.5)
        return self.at(inside, into_block_m).at(along_m - inside, 0.0)

    def _point(self, along_m: Number) -> tuple[float, float]:
        k = min(max(bisect_right(self._along, along_m), 1), len(self._along) - 1)
        low, high = self._along[k - 1], self._along[k]
        fraction = min(max((along_m - low) / (high - low), 0.0), 1.0)
        (ax, ay), (bx, by) = self._points[k - 1], self._points[k]
        return ax + fraction * (bx - ax), ay + fraction * (by - ay)


def furnish(
    theme: Theme,
    network: Network,
    ring: Ring,
    paved: bool,
    crossings: frozenset[tuple[int, bool]],
    site: Site,
    rng: np.random.Generator,
) -> None:
    """Put all objects along one block's sides: furniture, parked cars, plots."""
    for side in ring.sides:
        line, first, last = _Line(side), float(side.along_m[0]), float(side.along_m[-1])
        if paved:
            _furniture(theme, line, first, last, site, rng)
        elif rng.uniform() < theme.guard_rail_fraction:
            rail = random_variant(rng, "barrier", "guard")
            for s in np.arange(first + 6, last - 6, PIECE_M):
                site.put(rail, line.at(float(s), 0.6), follow=True)
        else:
            _verge(theme, line, first, last, site, rng)
        zebra = (side.edge, not side.forward) in crossings
        _corner_poles(network, line, first + (CROSSING_M[1] if zebra else 0.4), site, rng)
        _parked(theme, line, first + CROSSING_M[1] + 8, last - CROSSING_M[1] - 3, site, rng)
    for side in ring.sides:
        _plots(theme, side, site, rng)
    if theme.infill:
        for side in ring.sides:
            _infill(theme, side, site, rng)


def _walk(rng: np.random.Generator, first: Number, last: Number, gap_m: Number) -> Iterator[float]:
    """Yield positions from `first` to `last`, `gap_m` apart in the mean."""
    s = first + rng.uniform(0.2, 0.8) * gap_m
    while s < last:
        yield float(s)
        s += gap_m * rng.uniform(0.75, 1.25)


def _furniture(theme: Theme, line: _Line, first: Number, last: Number, site: Site, rng: np.random.Generator) -> None:
    taken = np.zeros(int((last - first) / 0.25) + 1, bool)

    def free(s: float, length_m: Number) -> bool:
        low, high = int((s - length_m / 2 - first) / 0.25), int((s + length_m / 2 - first) / 0.25) + 1
        # nothing within 22 steps of 0.25 m of the corners
        if low < 22 or high > len(taken) - 22 or taken[low:high].any():
            return False
        taken[low:high] = True
        return True

    strip = furniture_m(theme)
    for s in _walk(rng, first, last, theme.lamp_gap_m):
        if free(s, 1.0):
            site.put(random_variant(rng, "pole", theme.lamp), line.at(s, 0.5, np.pi))
    kinds = {kind: weight for kind, weight in theme.trees.items() if kind in _STREET_TREES}
    for s in _walk(rng, first, last, theme.tree_gap_m):
        if free(s, 1.6):
            color, kind = choice(rng, tree.LEAF_COLORS), weighted_choice(rng, kinds)
            mesh = random_variant(rng, "tree", kind)
            site.put(mesh, line.at(s, 0.6, float(rng.uniform(0, 6))), paint={Material.LEAVES: color})
    for s in _walk(rng, first, last, theme.prop_gap_m):
        kind = weighted_choice(rng, theme.props)
        length, across = prop.KINDS[kind].size_m
        if across > strip - 0.1:
            pose = line.at(s, theme.sidewalk_m + 0.5 + across / 2, np.pi)
            if site.plan.claim(pose, (length + 0.3, across + 0.1)):
                site.put(random_variant(rng, "prop", kind), pose)
        elif free(s, length + 0.4):
            site.put(random_variant(rng, "prop", kind), line.at(s, 0.1 + across / 2, np.pi))
    for s in _walk(rng, first, last, 34.0):
        if free(s, 0.8):
            site.put(random_variant(rng, "pole", "sign"), line.at(s, 0.5))


def _verge(theme: Theme, line: _Line, first: Number, last: Number, site: Site, rng: np.random.Generator) -> None:
    """Put delineator signs and trees on the grass beside the street."""
    for k, s in enumerate(_walk(rng, first + 4, last - 4, theme.tree_gap_m)):
        if k % 3 == 2:
            site.put(random_variant(rng, "pole", "sign"), line.at(s, 0.7))
        else:
            color = choice(rng, tree.LEAF_COLORS)
            mesh = random_variant(rng, "tree", "round" if k % 3 else "young")
            site.put(mesh, line.at(s, 1.1), paint={Material.LEAVES: color})


def _corner_poles(network: Network, line: _Line, along_m: Number, site: Site, rng: np.random.Generator) -> None:
    """Put a traffic light (or a sign) at the junction to which the cars of this side drive, facing them."""
    edge, pose = network.edges[line.side.edge], line.at(along_m + 0.6, 0.55)
    meeting = degrees(network)[edge.start if line.side.forward else edge.end]
    if edge.lanes > 1 and meeting > 2:
        site.put(random_variant(rng, "pole", "light"), pose)
        site.signals.append(Signal((line.side.edge, not line.side.forward), pose))
    else:
        site.put(random_variant(rng, "pole", "sign"), pose)


def _parked(theme: Theme, line: _Line, first: Number, last: Number, site: Site, rng: np.random.Generator) -> None:
    if not np.isfinite(theme.parked_gap_m):
        return
    end = first
    for s in _walk(rng, first, last, theme.parked_gap_m):
        mesh = random_variant(rng, "vehicle", weighted_choice(rng, vehicle.PARKED))
        length, width, _ = vehicle.size_m(mesh)
        if s - length / 2 < end + 0.5 or s + length / 2 > last:
            continue
        end = s + length / 2
        pose = line.at(s, -0.12 - width / 2, np.pi + float(rng.uniform(-0.015, 0.015)))
        color = choice(rng, vehicle.PAINTS)
        site.put(mesh, pose, lift_m=0.03, paint={Material.CAR_PAINT: color})


_TRIALS = ((1.0, 1.0, 0.55), (1.0, 0.8, 1.2), (0.75, 0.8, 0.55), (0.55, 0.8, 0.55), (0.55, 0.6, 1.2))
"""Fractions of a plot's depth and width, and metres behind the sidewalk, in the order in which they are tried."""


def _plots(theme: Theme, side: Side, site: Site, rng: np.random.Generator) -> None:
    line, s = _Line(side), float(side.along_m[0]) - 8.0
    while s < side.along_m[-1] + 8:
        wide, deep = float(rng.uniform(*theme.plot_width_m)), float(rng.uniform(20, 30))
        kind = weighted_choice(rng, theme.plots)
        for shrink, narrow, back in _TRIALS:
            width, depth = wide * narrow, deep * shrink
            front = line.front(s + width / 2, theme.sidewalk_m + back)
            if depth > theme.setback_m[1] + 6 and site.plan.claim(front.at(0, depth / 2), (width - 0.4, depth - 0.2)):
                plot.KINDS[kind](plot.Plot(site, theme, rng, front, width - 0.4, depth - 0.2))
                s += width + 0.3
                break
        else:
            s += 2.5


def _infill(theme: Theme, side: Side, site: Site, rng: np.random.Generator) -> None:
    """Put narrow houses into the gaps between plots."""
    line = _Line(side)
    for s in np.arange(float(side.along_m[0]) - 6, float(side.along_m[-1]) + 6, 2.2):
        for width, depth in ((6.5, 9.0), (4.6, 8.0)):
            front = line.front(float(s), theme.sidewalk_m + 0.55)
            if site.plan.claim(front.at(0, depth / 2), (width, depth)):
                plot.KINDS["row"](plot.Plot(site, theme, rng, front, width + 0.3, depth))
                break
