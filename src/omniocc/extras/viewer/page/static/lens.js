// Pixels to rays, by the tables of directions that omniocc.extras.viewer.page.lens made with the rig's own lens models.

import { bytesOf } from "omniocc/data.js";

// Return { origin (m), direction } in the ego frame of the ray of pixel (u, v); integers are centres of pixels. Null
// outside the image, where the lens does not see, and where the mask hides the own car.
export async function rayOf(camera, u, v) {
  const column = Math.round(u), row = Math.round(v);
  if (!(column >= 0 && row >= 0 && column < camera.width && row < camera.height)) return null;
  const [table, valid] = await Promise.all([bytesOf(camera.directions), bytesOf(camera.valid)]);
  const bit = row * camera.width + column;
  if (!(valid[bit >> 3] & (128 >> (bit & 7)))) return null;
  return { origin: camera.origin, direction: interpolate(camera, new Int16Array(table.buffer), u, v) };
}

// Directions are known at every `step` pixels; between them they are interpolated linearly along both axes.
function interpolate({ step, columns, rows }, table, u, v) {
  const [i, right] = place(u / step, columns), [j, below] = place(v / step, rows);
  const mixed = [0, 1, 2].map(axis => {
    const at = (row, column) => table[(row * columns + column) * 3 + axis];
    const upper = at(j, i) * (1 - right) + at(j, i + 1) * right, lower = at(j + 1, i) * (1 - right) + at(j + 1, i + 1) * right;
    return upper * (1 - below) + lower * below;
  });
  const length = Math.hypot(...mixed);
  return mixed.map(value => value / length);
}

function place(at, count) {
  const node = Math.min(Math.max(Math.floor(at), 0), count - 2);
  return [node, at - node];
}

// Return the direction of a place in a panorama, both coordinates from 0 to 1 from its upper left corner.
export function panoramaDirection({ top_deg, bottom_deg }, across, down) {
  const azimuth = Math.PI * (1 - 2 * across), elevation = (top_deg - (top_deg - bottom_deg) * down) * Math.PI / 180;
  return [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)];
}
