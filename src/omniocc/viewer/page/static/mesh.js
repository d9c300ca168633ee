// The surface of the visible cells, as omniocc.geometry.surface has it, with neighbouring faces of one class merged.
//
// A merged face is exactly the union of the faces of its cells. In a cuboid faces merge along both axes of their plane.
// In a cylinder, whose curved faces are flat chords, merging along theta would bend a face, so faces merge along r and
// z only: those of constant theta along both, those of constant z along r, those of constant r along z.

const WORDS = 8; // axis, side, layer, first and last (excluded) cell along both axes of the plane, label

// Return merged faces as rows of eight numbers: axis of the normal, side (0 lower, 1 upper), index of the cells along
// that axis, begin and end along the next axis, begin and end along the one after, label.
export function faces(grid, labels, visible) {
  const found = new Rows();
  for (let axis = 0; axis < 3; axis++) {
    for (let side = 0; side < 2; side++) facesOf(grid, labels, visible, axis, side, found);
  }
  return found.done();
}

function facesOf(grid, labels, visible, axis, side, found) {
  const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
  const [layers, columns, rows] = [axis, u, v].map(each => grid.shape[each]);
  const [across, along, up] = [axis, u, v].map(each => grid.strides[each]);
  const merges = [u, v].map(each => !(grid.cylinder && each === 1));
  const open = new Uint8Array(columns * rows);
  for (let layer = 0; layer < layers; layer++) {
    if (grid.cylinder && axis === 0 && side === 0 && layer === 0 && grid.bounds[0][0] === 0) continue; // no area
    const next = neighbor(grid, axis, layer, side);
    let any = false;
    for (let i = 0, at = 0; i < columns; i++) {
      for (let j = 0; j < rows; j++, at++) {
        const cell = layer * across + i * along + j * up, label = labels[cell];
        const exposed = visible[label] && !(next >= 0 && visible[labels[cell + (next - layer) * across]]);
        open[at] = exposed ? label : 0;
        any ||= exposed;
      }
    }
    if (any) merge(open, columns, rows, merges, (i0, i1, j0, j1, label) => found.add(axis, side, layer, i0, i1, j0, j1, label));
  }
}

function neighbor(grid, axis, layer, side) {
  const next = layer + (side ? 1 : -1);
  if (next >= 0 && next < grid.shape[axis]) return next;
  return grid.cylinder && axis === 1 ? (next + grid.shape[1]) % grid.shape[1] : -1;
}

// Cover the non-zero entries of a table with rectangles of equal entries, emptying it.
function merge(open, columns, rows, [alongColumns, alongRows], found) {
  for (let i = 0; i < columns; i++) {
    for (let j = 0; j < rows; j++) {
      const label = open[i * rows + j];
      if (label === 0) continue;
      let endRow = j + 1, end = i + 1;
      while (alongRows && endRow < rows && open[i * rows + endRow] === label) endRow++;
      while (alongColumns && end < columns && same(open, end * rows, j, endRow, label)) end++;
      for (let each = i; each < end; each++) open.fill(0, each * rows + j, each * rows + endRow);
      found(i, end, j, endRow, label);
    }
  }
}

function same(open, base, from, to, label) {
  for (let at = base + from; at < base + to; at++) if (open[at] !== label) return false;
  return true;
}

// Return the vertices of faces, four for each: positions (m), normals, position in their plane in cells, and labels.
export function vertices(grid, rows) {
  const count = rows.length / WORDS;
  const mesh = {
    position: new Float32Array(count * 12), normal: new Float32Array(count * 12), place: new Float32Array(count * 8),
    label: new Uint8Array(count * 4), index: new Uint32Array(count * 6),
  };
  for (let face = 0; face < count; face++) addFace(grid, rows.subarray(face * WORDS, (face + 1) * WORDS), face, mesh);
  return mesh;
}

function addFace(grid, [axis, side, layer, i0, i1, j0, j1, label], face, mesh) {
  const around = [[i0, j0], [i1, j0], [i1, j1], [i0, j1]]; // counter-clockwise seen from outside
  if (side === 0) around.reverse();
  const corners = around.map(([i, j]) => {
    const at = [0, 0, 0];
    at[axis] = layer + side;
    at[(axis + 1) % 3] = i;
    at[(axis + 2) % 3] = j;
    return grid.corner(...at);
  });
  const normal = cross(minus(corners[2], corners[0]), minus(corners[3], corners[1]));
  const length = Math.hypot(...normal) || 1;
  corners.forEach((corner, k) => {
    const vertex = face * 4 + k;
    mesh.position.set(corner, vertex * 3);
    mesh.normal.set(normal.map(value => value / length), vertex * 3);
    mesh.place.set(around[k], vertex * 2);
    mesh.label[vertex] = label;
  });
  mesh.index.set([0, 1, 2, 0, 2, 3].map(k => face * 4 + k), face * 6);
}

const minus = (a, b) => a.map((value, axis) => value - b[axis]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// An Int32Array that grows.
class Rows {
  constructor() {
    this.data = new Int32Array(WORDS * 4096);
    this.length = 0;
  }

  add(...row) {
    if (this.length + WORDS > this.data.length) {
      const larger = new Int32Array(this.data.length * 2);
      larger.set(this.data);
      this.data = larger;
    }
    this.data.set(row, this.length);
    this.length += WORDS;
  }

  done() {
    return this.data.slice(0, this.length);
  }
}
