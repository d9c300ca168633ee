"""First hits of rays, a column of cells at a time.

The occupied levels of a column are the bits of one number, the levels that a ray crosses inside the column those of
another; the ray hits something in the first column where the two have a bit in common. All rays take one column at a
time, without branches, and the rays of a fan share the columns.
"""

import functools
from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float, Float32, Int, Int32, Int64, UInt8
from torch import Tensor

from omniocc.classes import FREE
from omniocc.geometry.columns import find_columns, find_lengths, find_levels
from omniocc.geometry.crossings import TOUCH_M, clip_slab
from omniocc.geometry.fans import Fans, Scan
from omniocc.geometry.trace import Hits, Traversable

BLOCK = 16
"""Columns whose masks are made together; for a few origins they should stay in the cache."""
CHUNK_SINGLE_RAYS = 1 << 12
"""Rays that share nothing and are cast together."""


class RayTable:
    """What is the same for all labels about rays through one grid.

    The masks of all rays take about two bytes for every column that a ray crosses. They are kept from the second
    look-up on: rays from a frame's own origins have one, of prediction and truth together.

    Args:
        grid: cylinder or cuboid.
        fans: the rays.
    """

    def __init__(self, grid: Traversable, fans: Fans):
        self.shape = grid.shape
        origins, headings = fans.headings.shape[:2]
        # those with a long way first, so that whoever still has columns left is among the first
        outer, order = _longest_first(grid, fans)
        along = fans.headings.flatten(0, 1).index_select(0, order)
        found = find_columns(grid, fans.origins.index_select(0, order // max(headings, 1)), along)
        self.cells = found.cells.reshape(len(found.cells), origins, headings)
        self.ends = found.ends.reshape(origins, headings, found.ends.shape[1])
        self.rank = torch.zeros(len(self.cells) + 1, origins, headings, dtype=torch.int32, device=order.device)
        self.widths = _widths(found.count.reshape(origins, headings), len(self.cells))
        climbs = fans.slopes.shape[1]
        place = order.argsort()[fans.place // climbs] * climbs + fans.place % climbs
        self.fans = fans._replace(
            origins=fans.origins[outer], slopes=fans.slopes[outer], stretches=fans.stretches[outer], place=place.int()
        )
        self.levels = find_levels(grid, self.fans)
        self.leave_m = self._leave_m(grid)
        self.uses, self.kept = 0, []

    def cast(self, labels: UInt8[Tensor, "X Y Z"]) -> Hits:
        """Finds the first cell along each ray that is not free (0); unknown (255) is not free.

        Raises:
            ValueError: if the labels do not have the grid's shape.
        """
        return self.cast_all([labels])[0]

    def cast_all(self, volumes: Sequence[UInt8[Tensor, "X Y Z"]]) -> list[Hits]:
        """As `cast` for several label volumes; cheaper than one after the other."""
        for labels in volumes:
            if labels.shape != self.shape:
                raise ValueError(f"labels must have the grid's shape {self.shape}, got {tuple(labels.shape)}")
        bits = [self._bits(labels) for labels in volumes]
        hits = [self._hits(*found) for found in zip(self._passed(bits), bits, volumes, strict=True)]
        return [Hits(*(part.flatten().index_select(0, self.fans.place) for part in found)) for found in hits]

    def reach_m(self) -> Float32[Tensor, " R"]:
        """Distance at which each ray leaves the grid; inf if it never meets it."""
        return self.leave_m.flatten().index_select(0, self.fans.place)

    def _leave_m(self, grid: Traversable) -> Float32[Tensor, "K A E"]:
        """Where rays leave the grid; inf for those that never meet it."""
        fans = self.fans
        enter, leave = clip_slab(fans.origins[:, 2:].expand_as(fans.slopes), fans.slopes, grid.bounds[2])
        first = torch.maximum(self.ends[..., :1], enter.unsqueeze(1))
        last = torch.minimum(self.ends[..., -1:], leave.unsqueeze(1))
        return (last * fans.stretches.unsqueeze(1)).masked_fill_(last <= first + TOUCH_M, float("inf")).float()

    def _bits(self, labels: UInt8[Tensor, "X Y Z"]) -> Int[Tensor, " bits"]:
        """The occupied levels of each column, and none for a place that is no column."""
        padded = torch.nn.functional.pad(labels, (0, -labels.shape[2] % 8)).to(torch.bool).contiguous()
        # eight cells of 0 or 1 in a word; the product has the lowest bits of all its bytes side by side on top
        packed = ((padded.flatten(0, 1).view(torch.int64) * 0x0102040810204080) >> 56) & 255
        bits = torch.zeros(len(packed) + 1, dtype=torch.int64, device=labels.device)
        for word in range(packed.shape[1]):
            bits[:-1] |= packed[:, word] << 8 * word
        return bits.to(self.levels.entered.dtype)

    def _blocks(self) -> Iterator[tuple[Int32[Tensor, "b k a"], Int[Tensor, "b k a E"]]]:
        """Some columns of all headings that have any left at a time: their cells and the rays' masks."""
        self.uses += 1
        for number, (origins, headings) in enumerate(self.widths):
            first = number * BLOCK
            cells = self.cells[first : first + BLOCK, :origins, :headings]
            masks = self.kept[number] if number < len(self.kept) else self._masks(first, cells.shape)
            if self.uses > 1 and number == len(self.kept):
                self.kept.append(masks)
            yield cells, masks

    def _masks(self, first: int, shape: torch.Size) -> Int[Tensor, "b k a E"]:
        """The levels that each ray crosses inside some columns."""
        columns, origins, headings = shape
        ends = self.ends[:origins, :headings, first : first + columns + 1].reshape(origins, headings * (columns + 1))
        rank = torch.searchsorted(self.levels.ways[:origins], ends.contiguous(), right=True, out_int32=True)
        rank += torch.arange(origins, device=rank.device).unsqueeze(1) * self.levels.entered.shape[1]
        rank = rank.reshape(origins, headings, columns + 1).permute(2, 0, 1).contiguous()
        self.rank[first : first + len(rank), :origins, :headings] = rank
        masks = self.levels.ahead.flatten(0, 1).index_select(0, rank[:-1].flatten())
        masks &= self.levels.entered.flatten(0, 1).index_select(0, rank[1:].flatten())
        return masks.reshape(*shape, masks.shape[1])

    def _passed(self, volumes: Sequence[Int[Tensor, " bits"]]) -> list[Int32[Tensor, "K A E"]]:
        """How many columns each ray crosses before the one with the hit, by the columns' bits of each volume."""
        done = [torch.zeros_like(self.leave_m, dtype=torch.bool) for _ in volumes]
        passed = [torch.zeros_like(self.leave_m, dtype=torch.int32) for _ in volumes]
        for cells, masks in self._blocks():
            _, origins, headings = cells.shape
            for bits, finished, count in zip(volumes, done, passed, strict=True):
                here = bits.index_select(0, cells.flatten()).reshape(*cells.shape, 1)
                found, within = (masks & here).to(torch.bool), finished[:origins, :headings]
                after = torch.zeros_like(within, dtype=torch.uint8)
                for column in found:
                    within |= column
                    after += within.view(torch.uint8)
                count[:origins, :headings] += len(cells) - after
        return passed

    def _hits(
        self, passed: Int32[Tensor, "K A E"], bits: Int[Tensor, " bits"], labels: UInt8[Tensor, "X Y Z"]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Cell, class, entry and exit distance of every ray, all (K, A, E)."""
        fans, levels = self.fans, self.levels
        origins, headings, climbs = passed.shape
        group = torch.arange(origins * headings, dtype=torch.int32, device=passed.device).reshape(origins, headings, 1)
        climb = torch.arange(climbs, dtype=torch.int32, device=passed.device)
        fan = torch.arange(origins, dtype=torch.int32, device=passed.device).reshape(-1, 1, 1) * climbs + climb
        passed = passed.clamp_(max=len(self.cells) - 1)
        place = passed * (origins * headings) + group
        column = _take(self.cells, place)
        found = _take(levels.ahead, _take(self.rank, place).mul_(climbs).add_(climb))
        found &= _take(levels.entered, _take(self.rank, place.add_(origins * headings)).mul_(climbs).add_(climb))
        found &= _take(bits, column)
        hit = found != 0
        level = _next_level(found, (fans.slopes > 0).unsqueeze(1), self.shape[2])
        cells = column.mul_(self.shape[2]).add_(level).masked_fill_(~hit, -1)
        place = passed.add_(group * self.ends.shape[-1])
        level = level.add_(fan * self.shape[2])
        stretch = fans.stretches.unsqueeze(1)
        entry = torch.maximum(_take(self.ends, place), _take(levels.enter, level)).mul_(stretch).float()
        exit_ = torch.minimum(_take(self.ends, place.add_(1)), _take(levels.leave, level)).mul_(stretch).float()
        return (
            cells,
            torch.where(hit, _take(labels, cells.clamp(min=0)), FREE),
            torch.where(hit, entry, self.leave_m),
            torch.where(hit, exit_, self.leave_m),
        )


def _longest_first(grid: Traversable, fans: Fans) -> tuple[Int64[Tensor, " K"], Int64[Tensor, " G"]]:
    """Order of the origins, and of all headings, origin by origin: the longest way through the grid comes first."""
    origins, headings = fans.headings.shape[:2]
    repeated = fans.origins.repeat_interleave(headings, dim=0)
    length, inner = (
        find_lengths(grid, repeated, fans.headings.flatten(0, 1))
        .reshape(origins, headings)
        .sort(dim=1, descending=True)
    )
    outer = length[:, 0].argsort(descending=True) if headings else inner.new_zeros(0)
    return outer, (inner + torch.arange(origins, device=inner.device).unsqueeze(1) * headings)[outer].flatten()


def _widths(count: Int64[Tensor, "K A"], columns: int) -> list[tuple[int, int]]:
    """How many of the first origins and of their first headings have columns left where each block begins."""
    if not count.numel():
        return []
    left = count > torch.arange(0, columns, BLOCK, device=count.device).reshape(-1, 1, 1)
    widths = []
    for dim in (2, 1):
        some = left.any(dim)
        number = torch.arange(1, some.shape[1] + 1, device=count.device)
        widths.append((some * number).amax(1).tolist())
    return list(zip(*widths, strict=True))


def _take(values: Tensor, place: Int32[Tensor, "K A E"]) -> Tensor:
    return values.flatten().index_select(0, place.flatten()).reshape(place.shape)


def _next_level(found: Int[Tensor, "K A E"], rising: Tensor, levels: int) -> Int32[Tensor, "K A E"]:
    """The lowest level in a mask for rising rays, else the highest; 0 for none."""
    found = found.long() & ((1 << levels) - 1)
    # the highest bit stays the highest, and what is left below it is too little to round up to the next one
    single = torch.where(rising, found & -found, found & ~(found >> 1))
    exponent = (single.double().view(torch.int64) >> 52) - 1023
    return exponent.clamp_(min=0).int()


def cast(
    grid: Traversable,
    labels: UInt8[Tensor, "X Y Z"],
    origins: Float[Tensor, "R 3"],
    directions: Float[Tensor, "R 3"],
) -> Hits:
    """Finds the first cell along each ray that is not free (0); unknown (255) is not free.

    For rays that form a LiDAR's raster, or that stay the same, `ray_table` is many times faster.

    Args:
        grid: cylinder or cuboid.
        labels: class of every cell.
        origins: ego frame, metres.
        directions: any length but zero.

    Raises:
        ValueError: if the labels do not have the grid's shape.
    """
    parts = []
    for first in range(0, max(len(origins), 1), CHUNK_SINGLE_RAYS):
        chunk = slice(first, first + CHUNK_SINGLE_RAYS)
        parts.append(RayTable(grid, Fans.single(origins[chunk], directions[chunk])).cast(labels))
    return Hits(*(torch.cat(part) for part in zip(*parts, strict=True)))


def ray_table(grid: Traversable, origins: Float[Tensor, "O 3"], scan: Scan) -> RayTable:
    """Prepares rays for look-ups, or takes them from the last few that were asked for.

    Args:
        grid: cylinder or cuboid; equal grids share a table.
        origins: ego frame, metres; the table lives on their device.
        scan: directions from each origin; the table's rays are in the order of `Scan.rays`.
    """
    return _cached(grid, origins.double().cpu().numpy().tobytes(), scan, str(origins.device))


@functools.lru_cache(maxsize=4)
def _cached(grid: Traversable, origins: bytes, scan: Scan, device: str) -> RayTable:
    places = torch.frombuffer(bytearray(origins), dtype=torch.float64).reshape(-1, 3).to(device)
    return RayTable(grid, scan.fans(places))
