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
    const next = neighbor(grid, axis, layer, side), ahead = (next - layer) * across;
    let any = 0;
    for (let i = 0, at = 0; i < columns; i++) {
      let cell = layer * across + i * along;
      for (let j = 0; j < rows; j++, at++, cell += up) {
        const label = labels[cell];
        if (visible[label] === 0 || (next >= 0 && visible[labels[cell + ahead]] !== 0)) continue;
        open[at] = label;
        any = 1;
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
// Faces are larger by `overlap` on all sides, m: where one ends along the side of another, rounding leaves gaps.
export function vertices(grid, rows, overlap) {
  const count = rows.length / WORDS;
  const mesh = {
    position: new Float32Array(count * 12), normal: new Float32Array(count * 12), place: new Float32Array(count * 8),
    label: new Uint8Array(count * 4), index: new Uint32Array(count * 6),
  };
  const corners = new Float64Array(12), normal = new Float64Array(3);
  for (let face = 0; face < count; face++) {
    const at = face * WORDS;
    placeCorners(grid, rows, at, corners, mesh.place, face * 8);
    normalOf(corners, normal);
    for (let corner = 0; corner < 4; corner++) {
      const vertex = face * 4 + corner;
      mesh.position.set(widened(corners, corner, overlap), vertex * 3);
      mesh.normal.set(normal, vertex * 3);
      mesh.label[vertex] = rows[at + 7];
    }
    for (let k = 0; k < 6; k++) mesh.index[face * 6 + k] = face * 4 + TRIANGLES[k];
  }
  return mesh;
}

const TRIANGLES = [0, 1, 2, 0, 2, 3];
const AROUND = [[0, 0, 1, 0, 1, 1, 0, 1], [0, 1, 1, 1, 1, 0, 0, 0]]; // corners in turn: of upper faces, of lower ones

// Write the four corners of a face, counter-clockwise seen from outside, and their places in its plane.
function placeCorners(grid, rows, at, corners, places, to) {
  const axis = rows[at], side = rows[at + 1], around = AROUND[1 - side], index = [0, 0, 0];
  index[axis] = rows[at + 2] + side;
  for (let corner = 0; corner < 4; corner++) {
    const i = rows[at + 3 + around[corner * 2]], j = rows[at + 5 + around[corner * 2 + 1]];
    index[(axis + 1) % 3] = i;
    index[(axis + 2) % 3] = j;
    corners.set(grid.corner(index[0], index[1], index[2]), corner * 3);
    places[to + corner * 2] = i;
    places[to + corner * 2 + 1] = j;
  }
}

// Write the unit normal: the cross product of the diagonals.
function normalOf(c, normal) {
  const a = c[6] - c[0], b = c[7] - c[1], d = c[8] - c[2], e = c[9] - c[3], f = c[10] - c[4], g = c[11] - c[5];
  normal[0] = b * g - d * f;
  normal[1] = d * e - a * g;
  normal[2] = a * f - b * e;
  const length = Math.hypot(normal[0], normal[1], normal[2]) || 1;
  for (let axis = 0; axis < 3; axis++) normal[axis] /= length;
}

const moved = new Float64Array(3);

// A corner moved outwards along both of its sides.
function widened(corners, corner, overlap) {
  for (let axis = 0; axis < 3; axis++) moved[axis] = corners[corner * 3 + axis];
  for (const other of [(corner + 1) % 4, (corner + 3) % 4]) {
    const x = corners[corner * 3] - corners[other * 3], y = corners[corner * 3 + 1] - corners[other * 3 + 1], z = corners[corner * 3 + 2] - corners[other * 3 + 2];
    const scale = overlap / (Math.sqrt(x * x + y * y + z * z) || 1);
    moved[0] += scale * x;
    moved[1] += scale * y;
    moved[2] += scale * z;
  }
  return moved;
}

// An Int32Array that grows.
class Rows {
  constructor() {
    this.data = new Int32Array(WORDS * 4096);
    this.length = 0;
  }

  add(axis, side, layer, i0, i1, j0, j1, label) {
    if (this.length + WORDS > this.data.length) {
      const larger = new Int32Array(this.data.length * 2);
      larger.set(this.data);
      this.data = larger;
    }
    const { data } = this;
    let at = this.length;
    data[at++] = axis; data[at++] = side; data[at++] = layer; data[at++] = i0; data[at++] = i1; data[at++] = j0; data[at++] = j1; data[at++] = label;
    this.length = at;
  }

  done() {
    return this.data.slice(0, this.length);
  }
}
