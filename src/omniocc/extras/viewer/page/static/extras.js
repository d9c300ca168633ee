// What is drawn beside voxels: the ego car, the outline of the grid, the chosen ray and the cells that it hits.

import { BufferAttribute, BufferGeometry, Color, Group, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, Vector3 } from "three";

const CORNERS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]];
const QUADS = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
const BRIGHTNESS = [0.6, 1, 0.86, 0.8, 0.9, 0.8];
const EDGES = [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];

// The ego car as boxes, [bounds along x, y, z; RGB] each.
export function car(boxes) {
  const group = new Group();
  for (const { bounds, rgb } of boxes) {
    const corners = CORNERS.map(corner => corner.map((side, axis) => bounds[axis][side]));
    group.add(new Mesh(solid(corners, rgb), new MeshBasicMaterial({ vertexColors: true })));
  }
  return group;
}

function solid(corners, rgb) {
  const geometry = new BufferGeometry(), position = [], color = [];
  QUADS.forEach((quad, side) => {
    const shade = new Color().setRGB(...rgb.map(part => part / 255 * BRIGHTNESS[side]), "srgb");
    for (const corner of [0, 1, 2, 0, 2, 3]) {
      position.push(...corners[quad[corner]]);
      color.push(shade.r, shade.g, shade.b);
    }
  });
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(position), 3));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(color), 3));
  return geometry;
}

// Line segments between pairs of points.
function segments(pairs, color, onTop) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(pairs.flat(2)), 3));
  const lines = new LineSegments(geometry, new LineBasicMaterial({ color, depthTest: !onTop, transparent: onTop }));
  lines.renderOrder = onTop ? 3 : 0;
  return lines;
}

// The outline of a grid's floor.
export function outline(grid, color) {
  const [first, second] = grid.shape, at = (i, j) => grid.corner(i, j, 0), pairs = [];
  for (let j = 0; j < second; j++) pairs.push([at(first, j), at(first, j + 1)]);
  if (!grid.cylinder) {
    for (let j = 0; j < second; j++) pairs.push([at(0, j), at(0, j + 1)]);
    pairs.push([at(0, 0), at(first, 0)], [at(0, second), at(first, second)]);
  }
  return segments(pairs, color, false);
}

// A cell: its twelve edges, and its faces translucent, both in front of everything.
export function cellMark(grid, cell, color) {
  const [i, j, k] = grid.indices(cell), group = new Group();
  const corners = CORNERS.map(([a, b, c]) => grid.corner(i + a, j + b, k + c));
  const faces = new Mesh(solid(corners, [255, 255, 255]), new MeshBasicMaterial({ color, depthTest: false, transparent: true, opacity: 0.45 }));
  faces.renderOrder = 2;
  return group.add(faces, segments(EDGES.map(edge => edge.map(corner => corners[corner])), color, true));
}

// A ray from a point to a point as a thin bar, seen faintly also behind voxels.
export function bar(from, to, color, width_m) {
  const group = new Group(), start = new Vector3(...from), along = new Vector3(...to).sub(start);
  const aside = new Vector3(0, 0, 1).cross(along);
  if (aside.length() < 1e-6) aside.set(1, 0, 0);
  aside.setLength(width_m / 2);
  const above = along.clone().cross(aside).setLength(width_m / 2);
  const corners = CORNERS.map(([a, b, c]) => start.clone().addScaledVector(along, a).addScaledVector(aside, 2 * b - 1).addScaledVector(above, 2 * c - 1).toArray());
  const geometry = solid(corners, [255, 255, 255]);
  for (const behind of [false, true]) {
    const mesh = new Mesh(geometry, new MeshBasicMaterial({ color, depthTest: !behind, transparent: behind, opacity: behind ? 0.3 : 1 }));
    mesh.renderOrder = behind ? 2 : 1;
    group.add(mesh);
  }
  return group;
}

// Free the buffers of everything in a group and empty it.
export function clear(group) {
  group.traverse(object => {
    object.geometry?.dispose();
    object.material?.dispose();
  });
  group.clear();
}
