"""First hits of rays on a CPU, compiled by numba: fans of rays cross columns of cells, elevation by elevation.

The parameters (see `raycast.fans`) at which rays of an azimuth cross the boundaries of either horizontal axis are
computed in closed form and merged into columns. With the next occupied column of every level known at every column, a
ray needs one look-up per level. The rules of `raycast.crossings` hold: float64, boundaries closer than `TOUCH_M` are
the same, and errors do not accumulate.

All kernels are in one file, see `rayiou.compiled`. Inside loops over rays arrays are indexed and never
sliced: numba counts references to slices atomically, and threads would wait for one another.
"""

from math import atan2, copysign, floor, pi, sqrt
from typing import no_type_check

import numpy as np

from rayiou.compiled import compiled
from rayiou.raycast.crossings import FACE, FAR, TOUCH_M


@compiled
@no_type_check
def plane_params(origin, along, start, reach, low, size, cells, params):
    """Fill `params` as `plane_crossings` for one ray; return the first cell, its change at each, and their number."""
    index = min(max(floor((origin + start * along - low) / size), 0), cells - 1)
    if along == 0:
        return index, 0, 0
    step = 1 if along > 0 else -1
    first = index + (along > 0)
    total = cells - index if along > 0 else index + 1
    for i in range(total):
        # from the number of the boundary: adding a step at each crossing would add up its rounding errors
        params[i] = ((first + step * i) * size + low - origin) / along
        if params[i] >= reach:
            return index, step, i + 1
    return index, step, total


@compiled
@no_type_check
def ring_params(x, y, along_x, along_y, start, reach, low, size, cells, params):
    """Fill `params` as `ring_crossings`; return the first ring, the number of inward crossings, and that of all."""
    speed2 = along_x * along_x + along_y * along_y
    here_x, here_y = x + start * along_x, y + start * along_y
    ring = min(max(floor((sqrt(here_x * here_x + here_y * here_y) - low) / size), -1), cells - 1)
    if speed2 < TOUCH_M**2:  # vertical: it stays in one ring
        return ring, 0, 0
    nearest = -(x * along_x + y * along_y) / speed2
    miss2 = (x * along_y - y * along_x) ** 2 / speed2
    innermost = min(max(floor((sqrt(miss2) - low) / size), -1), cells - 1)
    distance = max(ring - innermost, 0)  # rounding can put the start one ring inside of the innermost
    turn = -distance if start < nearest else distance  # rings from the innermost one, negative on the way in
    middle = low + (innermost + 0.5) * size
    total = cells - innermost - turn
    for i in range(total):
        later = turn + i + 0.5  # the half makes the sign tell inner boundaries from outer ones
        radius = abs(later) * size + middle
        # a ray that only touches a ring may miss it by rounding: no root of a negative number
        params[i] = nearest + copysign(sqrt(max(radius * radius - miss2, 0.0) / speed2), later)
        if params[i] >= reach:
            return innermost + distance, max(-turn, 0), i + 1
    return innermost + distance, max(-turn, 0), total


@compiled
@no_type_check
def sector_of(x, y, cells, ahead):
    """Return the sector of a point, as `crossings._sector`."""
    return floor((atan2(y, x) + pi) * (cells / (2 * pi)) + ahead) % cells


@compiled
@no_type_check
def sector_params(x, y, along_x, along_y, start, reach, cells, faces, params):
    """Fill `params` as `sector_crossings`; return the first sector, its change at each, and their number."""
    speed2 = along_x * along_x + along_y * along_y
    side = x * along_y - y * along_x
    if speed2 < TOUCH_M**2:
        return sector_of(x + start * along_x, y + start * along_y, cells, 0.0), 0, 0
    if side**2 / speed2 < TOUCH_M**2:  # through the axis, where it changes to the opposite sector
        after, nearest = sector_of(along_x, along_y, cells, FACE), -(x * along_x + y * along_y) / speed2
        if start >= nearest - TOUCH_M:
            return after, 0, 0
        before = sector_of(-along_x, -along_y, cells, FACE)
        params[0] = nearest
        return before, after - before, 1
    index = sector_of(x + start * along_x, y + start * along_y, cells, 0.0)
    sweep = 1 if side > 0 else -1
    # faces are in the order of the sweep, twice around, so that their number needs no modulo
    sin, cos = (faces[0], faces[1]) if side > 0 else (faces[2], faces[3])
    first = index + 1 if side > 0 else cells - 1 - index
    total = (cells + 1) // 2  # faces half a turn apart are in one plane, which a ray crosses once
    for i in range(total):
        across = along_y * cos[first + i] - along_x * sin[first + i]
        param = (sin[first + i] * x - cos[first + i] * y) / across
        # all faces are ahead of the first sector: one before the start is so by rounding; a plane's far half is no face
        params[i] = max(param, start) if across * sweep > 0 else FAR
        if params[i] >= reach:
            return index, sweep, i + 1
    return index, sweep, total


@compiled
@no_type_check
def merge(first, second, place, sizes, start, leave, cells, ends):
    """Put the crossings of two axes in order; return the number of columns. Cells of no length are -1.

    `first` has parameters (with room for one more), their number, and how many of them lead to a smaller index;
    `second` parameters, their number, and the change of index at each, which wraps around. `place` is the first cell on
    both axes. The first column begins at `start`, the last ends at `leave`. The outputs are `cells`, the row-major
    index of each column, and `ends`, the parameters between them.
    """
    (params, number, down), (others, other_number, step) = first, second
    row, column = place
    rows, columns = sizes
    params[number] = others[other_number] = FAR  # never before `leave`: no list needs a test for its end
    i, j, count = 0, 0, 0
    last = ends[0] = start
    while last < leave:
        take = params[i] <= others[j]  # either order of equal ones: the column between them has no length
        param = min(max(params[i] if take else others[j], last), leave)
        inside = (param - last > TOUCH_M) & (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        cells[count] = row * columns + column if inside else -1
        count += 1
        last = ends[count] = param
        if take:
            row += 1 if i >= down else -1  # rings shrink until the closest approach, then they grow
            i += 1
        else:
            column += step
            column += columns if column < 0 else (-columns if column >= columns else 0)
            j += 1
    return count


@compiled
@no_type_check
def clip_round(x, y, along_x, along_y, radius):
    """Return the result of `clip_disc` for one ray."""
    speed2 = along_x * along_x + along_y * along_y
    if speed2 < TOUCH_M**2:
        return (-FAR, FAR) if x * x + y * y < radius * radius else (FAR, -FAR)
    nearest = -(x * along_x + y * along_y) / speed2
    miss2 = (x * along_y - y * along_x) ** 2 / speed2
    if not miss2 < radius * radius:  # a nan misses
        return FAR, -FAR
    offset = sqrt((radius * radius - miss2) / speed2)
    return nearest - offset, nearest + offset


@compiled
@no_type_check
def clip_flat(origin, along, low, high):
    """Return the result of `clip_slab` for one ray."""
    if along == 0:
        return (-FAR, FAR) if low <= origin < high else (FAR, -FAR)
    one, other = (low - origin) / along, (high - origin) / along
    return min(one, other), max(one, other)


@compiled
@no_type_check
def columns_of(group, rays, grid, scratch, cells, ends):
    """Find the columns along one azimuth, counted over all fans; return their number.

    Only those count in which some ray of the fan is inside the grid. `scratch` (2, longest + 1) is working memory; the
    outputs are those of `merge`.
    """
    origins, azimuths, spans = rays[0], rays[1], rays[5]
    _, bounds, sizes, faces = grid  # ends and cells of the horizontal axes; `sector_faces`, empty for a cuboid
    fan, azimuth = group // azimuths.shape[1], group % azimuths.shape[1]
    x, y, along_x, along_y = origins[fan, 0], origins[fan, 1], azimuths[fan, azimuth, 0], azimuths[fan, azimuth, 1]
    size = (bounds[0, 1] - bounds[0, 0]) / sizes[0]
    if faces.size:
        enter, leave = clip_round(x, y, along_x, along_y, bounds[0, 1])
    else:
        one = clip_flat(x, along_x, bounds[0, 0], bounds[0, 1])
        other = clip_flat(y, along_y, bounds[1, 0], bounds[1, 1])
        enter, leave = max(one[0], other[0]), min(one[1], other[1])
    start, leave = max(enter, spans[fan, 0], 0.0), min(leave, spans[fan, 1], FAR)
    if not leave > start + TOUCH_M:  # a nan misses
        ends[0] = 0.0
        return 0
    if faces.size:
        row, down, number = ring_params(
            x, y, along_x, along_y, start, leave, low=bounds[0, 0], size=size, cells=sizes[0], params=scratch[0]
        )
        column, step, others = sector_params(
            x, y, along_x, along_y, start, leave, cells=sizes[1], faces=faces, params=scratch[1]
        )
    else:
        row, step, number = plane_params(
            x, along_x, start, leave, bounds[0, 0], size, cells=sizes[0], params=scratch[0]
        )
        down = number if step < 0 else 0
        size = (bounds[1, 1] - bounds[1, 0]) / sizes[1]
        column, step, others = plane_params(
            y, along_y, start, leave, bounds[1, 0], size, cells=sizes[1], params=scratch[1]
        )
    first, second = (scratch[0], number, down), (scratch[1], others, step)
    return merge(first, second, (row, column), sizes, start, leave, cells=cells, ends=ends)


@compiled
@no_type_check
def pack(labels, bits):
    """Set the bits of the occupied levels of each column of labels (V, columns, levels)."""
    volumes, columns, levels = labels.shape
    for volume in range(volumes):
        for column in range(columns):
            word = 0
            for level in range(levels):
                word |= np.int64(labels[volume, column, level] != 0) << level
            bits[volume, column] = word


@compiled
@no_type_check
def first_hit(height, slope, edges, ends, count, bits):
    """Return column and level of the first hit of a ray; column -1 for none."""
    levels = len(edges) - 1
    step, ahead = (1, 1) if slope > 0 else (-1, 0)
    if slope == 0:
        level, enter, leave = np.searchsorted(edges, height, side="right") - 1, -FAR, FAR
    else:
        # one level early, as the place is rounded; a level that the ray has left by then holds no column
        place = floor((height + ends[0] * slope - edges[0]) / (edges[levels] - edges[0]) * levels) - step
        level = min(max(place, 0), levels - 1)
        enter, leave = (edges[level + 1 - ahead] - height) / slope, (edges[level + ahead] - height) / slope
    column = 0
    while 0 <= level < levels:
        while column < count and ends[column + 1] < enter + TOUCH_M:
            column += 1
        limit, bit = leave - TOUCH_M, 1 << level  # cells crossed over less than `TOUCH_M` do not count
        while ends[column] < limit:
            if bits[column] & bit:
                return (column if column < count else -1), level
            column += 1
        # the last column may reach into the next level
        level, column = level + step, max(column - 1, 0)
        if leave == FAR:  # a level ray
            break
        enter, leave = leave, (edges[level + ahead] - height) / slope
    return -1, 0


@compiled
@no_type_check
def find_turns(height, slope, edges, ends, count, turns):
    """Fill `turns`: for each edge between levels, in a ray's order, twice the number of columns that begin before it.

    One is added where the ray crosses the edge inside the last of these columns, which is then in both levels.
    """
    levels, column = len(edges) - 1, 0
    if slope == 0:
        start = np.searchsorted(edges, height, side="right") - 1
        for edge in range(levels + 1):
            turns[edge] = 2 * count if levels - edge <= start < levels else 0  # in the order of falling rays
        return
    for edge in range(levels + 1):
        param = (edges[edge if slope > 0 else levels - edge] - height) / slope
        while column < count and ends[column] < param - TOUCH_M:  # the tolerances are those of `first_hit`
            column += 1
        turns[edge] = 2 * column + (column > 0 and ends[column] >= param + TOUCH_M)


@compiled
@no_type_check
def next_hits(labels, cells, group, count, hits):
    """Fill `hits`, for every column and level, with the first occupied column from it on; `count` for none."""
    levels = labels.shape[1]
    for level in range(levels):
        hits[count, level] = count
    for column in range(count - 1, -1, -1):
        cell = cells[group, column]
        for level in range(levels):
            free = cell < 0 or labels[cell, level] == 0
            hits[column, level] = hits[column + 1, level] if free else column


@compiled
@no_type_check
def known_hit(group, elevation, begin, rising, turns, hits):
    """Return the result of `first_hit` from the turns of a ray, with one look-up for each level from an edge on."""
    levels = turns.shape[2] - 1
    turn = np.int64(turns[group, elevation, begin])
    for edge in range(begin, levels):
        level = edge if rising else levels - 1 - edge
        after = np.int64(turns[group, elevation, edge + 1])
        # from the column in which the ray comes into the level, to that in which it leaves it
        hit = hits[(turn >> 1) - (turn & 1), level]
        if hit < after >> 1:
            return hit, level
        turn = after
    return -1, 0


@compiled
@no_type_check
def hit_params(height, slope, edges, level, begin, end):
    """Return the parameters at which a ray enters and leaves the cell of a level in a column from `begin` to `end`."""
    if slope == 0:
        return begin, end
    one, other = (edges[level] - height) / slope, (edges[level + 1] - height) / slope
    return max(begin, min(one, other)), min(end, max(one, other))


@compiled
@no_type_check
def exit_param(height, slope, bottom, top, begin, end):
    """Return the parameter at which a ray without a hit leaves the grid; inf if it misses the grid."""
    enter, leave = clip_flat(height, slope, bottom, top)
    leave = min(end, leave)
    return leave if leave > max(begin, enter) + TOUCH_M else np.inf


@compiled
@no_type_check
def build(first, last, rays, grid, kept):
    """Fill the kept arrays of some azimuths: cells (G, L), ends (G, L + 1), counts (G) and turns (G, E, Z + 1)."""
    origins, azimuths, slopes = rays[0], rays[1], rays[2]
    cells, ends, counts, turns = kept
    scratch = np.empty((2, ends.shape[1]))
    for group in range(first, last):
        fan = group // azimuths.shape[1]
        counts[group] = columns_of(group, rays, grid, scratch, cells[group], ends[group])
        for elevation in range(slopes.shape[1]):
            find_turns(
                origins[fan, 2], slopes[fan, elevation], grid[0], ends[group], counts[group], turns[group, elevation]
            )


@compiled
@no_type_check
def cast_kept(first, last, rays, grid, kept, labels, out):
    """Cast the rays of some azimuths with known columns and turns through labels (columns, levels)."""
    origins, azimuths, slopes, stretches, order, _ = rays
    edges, cells, ends, counts, turns = grid[0], kept[0], kept[1], kept[2], kept[3]
    found_cells, found_labels, entry_m, exit_m = out
    each, elevations, levels = azimuths.shape[1], slopes.shape[1], len(edges) - 1
    bottom, top = edges[0], edges[levels]
    hits = np.empty((ends.shape[1], levels), dtype=np.int32)
    for group in range(first, last):
        fan, azimuth, count = group // each, group % each, counts[group]
        height = origins[fan, 2]
        next_hits(labels, cells, group, count, hits)
        # a rising ray crosses none of the levels below its origin; one more for the rounding
        start = min(max(floor((height - bottom) / (top - bottom) * levels), -1), levels + 1)
        for elevation in range(elevations):
            slope, stretch = slopes[fan, elevation], stretches[fan, elevation]
            ray = fan * each * elevations + order[azimuth * elevations + elevation]
            begin = max((start if slope > 0 else levels - 1 - start) - 1, 0)
            column, level = known_hit(group, elevation, begin, slope > 0, turns, hits)
            if column < 0:
                param = exit_param(height, slope, bottom, top, ends[group, 0], ends[group, count])
                found_cells[ray], found_labels[ray] = -1, 0
                entry_m[ray] = exit_m[ray] = param * stretch
                continue
            cell = cells[group, column]
            enter, leave = hit_params(height, slope, edges, level, ends[group, column], ends[group, column + 1])
            found_cells[ray], found_labels[ray] = cell * levels + level, labels[cell, level]
            entry_m[ray], exit_m[ray] = enter * stretch, leave * stretch


@compiled
@no_type_check
def cast(first, last, rays, grid, longest, volumes, packed, out):
    """Cast the rays of some azimuths through several volumes (V, columns, levels); `out` has V rows."""
    origins, azimuths, slopes, stretches, order, _ = rays
    edges = grid[0]
    found_cells, found_labels, entry_m, exit_m = out
    each, elevations, levels = azimuths.shape[1], slopes.shape[1], len(edges) - 1
    scratch, bits = np.empty((2, longest)), np.empty(longest, dtype=np.int64)
    cells, ends = np.empty(longest, dtype=np.int32), np.empty(longest)
    for group in range(first, last):
        fan, azimuth = group // each, group % each
        count, height = columns_of(group, rays, grid, scratch, cells, ends), origins[fan, 2]
        for volume in range(len(volumes)):
            for column in range(count):
                bits[column] = packed[volume, cells[column]] if cells[column] >= 0 else 0
            bits[count] = -1  # ends the search
            for elevation in range(elevations):
                slope, stretch = slopes[fan, elevation], stretches[fan, elevation]
                ray = fan * each * elevations + order[azimuth * elevations + elevation]
                column, level = first_hit(height, slope, edges, ends, count, bits)
                if column < 0:
                    param = exit_param(height, slope, edges[0], edges[levels], ends[0], ends[count])
                    found_cells[volume, ray], found_labels[volume, ray] = -1, 0
                    entry_m[volume, ray] = exit_m[volume, ray] = param * stretch
                    continue
                cell = cells[column]
                enter, leave = hit_params(height, slope, edges, level, ends[column], ends[column + 1])
                found_cells[volume, ray] = cell * levels + level
                found_labels[volume, ray] = volumes[volume, cell, level]
                entry_m[volume, ray], exit_m[volume, ray] = enter * stretch, leave * stretch
