// The first cell along a ray that stops it: as omniocc's `Grid.trace`, from sorted crossings with the grid's surfaces.
//
// The same steps as in omniocc.geometry.raycast (crossings.py, trace.py): every axis has a cell at the start of the ray
// and changes it by one at each crossing, so that rays along faces and through edges find the same cells.

export const FREE = 0, UNKNOWN = 255;
const TOUCH_M = 1e-9; // a cell crossed over less than this does not count, and a boundary this close counts as reached
const FACE = 1e-10; // a ray less than this (in sectors) below a sector's face belongs to the sector above it

// Return { label, cell, entry, exit } of the first cell whose label stops the ray (`stops` has a 1 for it), distances in
// m; label FREE and the distance at which the ray leaves the grid if there is none, Infinity for a ray that misses it.
// `unknown` is the length of the ray in unknown cells before that, m, and `unknownCell` the first of them, else -1.
export function trace(grid, labels, origin, direction, stops) {
  const length = Math.hypot(...direction), ray = direction.map(value => value / length);
  const [enter, leave] = clip(grid, origin, ray), start = Math.max(enter, 0);
  if (!(leave > start + TOUCH_M)) return { label: FREE, cell: -1, entry: Infinity, exit: Infinity, unknown: 0, unknownCell: -1 };
  let unknown = 0, unknownCell = -1;
  for (const { cell, from, to } of stretches(grid, origin, ray, start, leave)) {
    const label = cell < 0 ? FREE : labels[cell];
    if (stops[label]) return { label, cell, entry: from, exit: to, unknown, unknownCell };
    if (label !== UNKNOWN) continue;
    unknown += to - from;
    if (unknownCell < 0) unknownCell = cell;
  }
  return { label: FREE, cell: -1, entry: leave, exit: leave, unknown, unknownCell };
}

// Labels that stop a ray: all but free, and all but unknown unless `withUnknown`.
export function stopping(withUnknown) {
  const stops = new Uint8Array(256).fill(1);
  stops[FREE] = 0;
  stops[UNKNOWN] = withUnknown ? 1 : 0;
  return stops;
}

// Yield the cells along a ray, in order: flat index (negative in a cylinder's hole) and where each begins and ends, m.
function* stretches(grid, origin, ray, start, leave) {
  const axes = crossings(grid, origin, ray, start);
  let cell = axes.reduce((sum, { index }, axis) => sum + index * grid.strides[axis], 0), from = start;
  const changes = axes.flatMap(({ at, step }, axis) => at.map((where, k) => [Math.max(where, start), step[k] * grid.strides[axis]]));
  changes.push([leave, 0]);
  for (const [to, change] of changes.filter(([where]) => where <= leave).sort((a, b) => a[0] - b[0])) {
    if (to - from > TOUCH_M) yield { cell, from, to };
    cell += change;
    from = to;
  }
}

function clip(grid, origin, ray) {
  const slabs = (grid.cylinder ? [2] : [0, 1, 2]).map(axis => slab(origin[axis], ray[axis], grid.bounds[axis]));
  const spans = grid.cylinder ? [disc(origin, ray, grid.bounds[0][1]), ...slabs] : slabs;
  return [Math.max(...spans.map(span => span[0])), Math.min(...spans.map(span => span[1]))];
}

function slab(origin, speed, [low, high]) {
  if (speed === 0) return origin >= low && origin < high ? [-Infinity, Infinity] : [Infinity, -Infinity];
  const first = (low - origin) / speed, second = (high - origin) / speed;
  return [Math.min(first, second), Math.max(first, second)];
}

function disc(origin, ray, radius) {
  const { speed2, nearest, miss2 } = approach(origin, ray);
  if (miss2 >= radius * radius) return [Infinity, -Infinity];
  const offset = Math.sqrt((radius * radius - miss2) / speed2);
  return [nearest - offset, nearest + offset];
}

// The closest approach to the z axis: squared horizontal speed (negligible if vertical), distance along the ray, and
// squared radius.
function approach([x, y], [u, v]) {
  const speed2 = u * u + v * v;
  if (speed2 < TOUCH_M ** 2) return { speed2: 1e-60, nearest: 0, miss2: x * x + y * y };
  return { speed2, nearest: -(x * u + y * v) / speed2, miss2: (x * v - y * u) ** 2 / speed2 };
}

// For each axis the cell at the start, the distances of the crossings, and the change of the cell at each.
function crossings(grid, origin, ray, start) {
  const planes = axis => planeCrossings(grid, axis, origin[axis], ray[axis], start);
  return grid.cylinder ? [ringCrossings(grid, origin, ray, start), sectorCrossings(grid, origin, ray, start), planes(2)] : [0, 1, 2].map(planes);
}

function planeCrossings(grid, axis, origin, speed, start) {
  const low = grid.bounds[axis][0], size = grid.size[axis], cells = grid.shape[axis], sign = Math.sign(speed);
  const index = Math.min(Math.max(Math.floor((origin + start * speed - low) / size), 0), cells - 1);
  const count = sign > 0 ? cells - index : sign < 0 ? index + 1 : 0;
  const at = Array.from({ length: count }, (_, k) => ((index + (sign > 0) + k * sign) * size + low - origin) / speed);
  return { index, at, step: at.map(() => sign) };
}

// Index -1 is the hole inside the first ring. A ray approaches the axis, passes it, and leaves; `turn` counts the rings
// from the innermost one that it reaches, negative before the closest approach.
function ringCrossings(grid, origin, ray, start) {
  const low = grid.bounds[0][0], size = grid.size[0], cells = grid.shape[0];
  const ringOf = radius => Math.min(Math.max(Math.floor((radius - low) / size), -1), cells - 1);
  const { speed2, nearest, miss2 } = approach(origin, ray), innermost = ringOf(Math.sqrt(miss2));
  const x = origin[0] + start * ray[0], y = origin[1] + start * ray[1];
  const distance = Math.max(ringOf(Math.sqrt(x * x + y * y)) - innermost, 0), turn = start < nearest ? -distance : distance;
  const at = [], step = [];
  for (let later = turn + 0.5; later < cells - innermost; later++) {
    const radius = Math.abs(later) * size + low + (innermost + 0.5) * size;
    const offset = Math.sqrt(Math.max(radius * radius - miss2, 0) / speed2);
    at.push(nearest + Math.sign(later) * offset);
    step.push(Math.sign(later));
  }
  return { index: innermost + Math.abs(turn), at, step };
}

// Half-planes that start at the z axis; a ray sweeps less than half a turn in one sense, or changes to the opposite
// sector where it runs through the axis.
function sectorCrossings(grid, origin, ray, start) {
  const cells = grid.shape[1], { speed2, nearest, miss2 } = approach(origin, ray);
  const sectorOf = (x, y, ahead) => {
    const sector = Math.floor((Math.atan2(y, x) + Math.PI) * (cells / (2 * Math.PI)) + ahead) % cells;
    return sector < 0 ? sector + cells : sector;
  };
  const vertical = speed2 < TOUCH_M ** 2, through = miss2 < TOUCH_M ** 2 && !vertical;
  const after = sectorOf(ray[0], ray[1], FACE);
  if (through && start < nearest - TOUCH_M) {
    const before = sectorOf(-ray[0], -ray[1], FACE);
    return { index: before, at: [nearest], step: [after - before] };
  }
  if (through) return { index: after, at: [], step: [] };
  const index = sectorOf(origin[0] + start * ray[0], origin[1] + start * ray[1], 0);
  return vertical ? { index, at: [], step: [] } : sweep(grid, origin, ray, start, index);
}

function sweep(grid, origin, ray, start, index) {
  const cells = grid.shape[1], sense = Math.sign(origin[0] * ray[1] - origin[1] * ray[0]), at = [], step = [];
  for (let k = 0; k < Math.ceil(cells / 2); k++) {
    const boundary = (index + (sense > 0) + k * sense + 2 * cells) % cells;
    const sin = grid.sin[boundary], cos = grid.cos[boundary], across = ray[1] * cos - ray[0] * sin;
    const where = (origin[0] * sin - origin[1] * cos) / across;
    // a line crosses the whole plane once: on the far side of the axis against the sweep, or before the ray begins
    if (!(across * sense > 0) || !(where >= start - TOUCH_M)) continue;
    at.push(where);
    step.push(boundary === 0 ? sense * (1 - cells) : sense);
  }
  return { index, at, step };
}
