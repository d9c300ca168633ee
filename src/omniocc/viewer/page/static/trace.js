// The first cell along a ray that stops it: as omniocc's `Grid.trace`, from sorted crossings with the grid's surfaces.

export const FREE = 0, UNKNOWN = 255;
const TOUCH_M = 1e-9; // a cell crossed over less than this does not count

// Return { label, cell, entry, exit } of the first cell whose label stops the ray (`stops` has a 1 for it), distances in
// m; label FREE and the distance at which the ray leaves the grid if there is none, Infinity for a ray that misses it.
// `unknown` is the length of the ray in unknown cells before that, m.
export function trace(grid, labels, origin, direction, stops) {
  const length = Math.hypot(...direction), ray = direction.map(value => value / length);
  const [start, leave] = clip(grid, origin, ray);
  const miss = { label: FREE, cell: -1, entry: Infinity, exit: Infinity, unknown: 0 };
  if (!(leave > start + TOUCH_M)) return miss;
  let unknown = 0;
  for (const { cell, from, to } of stretches(grid, origin, ray, start, leave)) {
    const label = cell < 0 ? FREE : labels[cell];
    if (stops[label]) return { label, cell, entry: from, exit: to, unknown };
    if (label === UNKNOWN) unknown += to - from;
  }
  return { ...miss, entry: leave, exit: leave, unknown };
}

// The cells along a ray, in order: flat index (-1 in a cylinder's hole) and distances at which each begins and ends.
function stretches(grid, origin, ray, start, leave) {
  const ends = crossings(grid, origin, ray).filter(at => at > start && at < leave).sort((a, b) => a - b);
  const found = [];
  let from = start;
  for (const to of [...ends, leave]) {
    if (to - from <= TOUCH_M) continue;
    const middle = (from + to) / 2;
    const cell = grid.cellOf(...[0, 1, 2].map(axis => origin[axis] + middle * ray[axis]));
    if (found.at(-1)?.cell === cell) found.at(-1).to = to;
    else found.push({ cell, from, to });
    from = to;
  }
  return found;
}

// Labels that stop a ray: all but free, and all but unknown unless `withUnknown`.
export function stopping(withUnknown) {
  const stops = new Uint8Array(256).fill(1);
  stops[FREE] = 0;
  stops[UNKNOWN] = withUnknown ? 1 : 0;
  return stops;
}

function clip(grid, origin, ray) {
  const spans = grid.cylinder
    ? [disc(origin, ray, grid.bounds[0][1]), slab(origin[2], ray[2], grid.bounds[2])]
    : grid.bounds.map((bounds, axis) => slab(origin[axis], ray[axis], bounds));
  return [Math.max(0, ...spans.map(span => span[0])), Math.min(...spans.map(span => span[1]))];
}

function slab(origin, speed, [low, high]) {
  if (speed === 0) return origin >= low && origin < high ? [-Infinity, Infinity] : [Infinity, -Infinity];
  const first = (low - origin) / speed, second = (high - origin) / speed;
  return [Math.min(first, second), Math.max(first, second)];
}

function disc(origin, ray, radius) {
  return ringRoots(approach(origin, ray), radius) ?? [Infinity, -Infinity];
}

// Squared horizontal speed, distance of the point nearest to the z axis, and its squared radius.
function approach([x, y], [u, v]) {
  const speed2 = u * u + v * v;
  if (speed2 < TOUCH_M ** 2) return { speed2: 0, nearest: 0, miss2: x * x + y * y };
  return { speed2, nearest: -(x * u + y * v) / speed2, miss2: (x * v - y * u) ** 2 / speed2 };
}

function ringRoots({ speed2, nearest, miss2 }, radius) {
  const room2 = radius * radius - miss2;
  if (room2 <= 0) return null;
  if (speed2 === 0) return [-Infinity, Infinity];
  const offset = Math.sqrt(room2 / speed2);
  return [nearest - offset, nearest + offset];
}

// All distances at which the line crosses a boundary of any axis, in no order.
function crossings(grid, origin, ray) {
  const found = [];
  const planes = axis => { if (ray[axis] !== 0) for (const edge of grid.edges[axis]) found.push((edge - origin[axis]) / ray[axis]); };
  planes(2);
  if (!grid.cylinder) {
    planes(0);
    planes(1);
    return found;
  }
  const nearest = approach(origin, ray);
  for (const radius of grid.edges[0]) {
    const roots = ringRoots(nearest, radius);
    if (roots !== null) found.push(...roots);
  }
  found.push(nearest.nearest); // where a ray through the axis changes to the opposite sector
  for (let k = 0; k < grid.shape[1]; k++) {
    const across = ray[1] * grid.cos[k] - ray[0] * grid.sin[k];
    // also where the line crosses the plane on the other side of the axis, inside a cell
    if (across !== 0) found.push((origin[0] * grid.sin[k] - origin[1] * grid.cos[k]) / across);
  }
  return found;
}
