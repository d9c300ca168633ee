// The material of voxels: class colours under a fixed sun, with the edges of cells drawn in merged faces.

import { BufferAttribute, BufferGeometry, Color, DataTexture, ShaderMaterial } from "three";
import { faces, vertices } from "omniocc/mesh.js";

const OVERLAP_M = 0.005; // a few hundredths of a pixel at the far end of a grid, too little to see nearby

const VERTEX = `
attribute vec2 place;
attribute float label;
varying vec2 cell;
varying vec3 position_m;
varying vec3 outward;
flat varying int kind;
void main() {
  cell = place;
  position_m = position;
  outward = normal;
  kind = int(label + 0.5);
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}`;

const FRAGMENT = `
uniform sampler2D palette;
uniform vec3 haze;
uniform float road_m;
uniform float clear_m;
varying vec2 cell;
varying vec3 position_m;
varying vec3 outward;
flat varying int kind;
void main() {
  vec3 color = texelFetch(palette, ivec2(kind, 0), 0).rgb;
  float sun = clamp(dot(outward, normalize(vec3(-0.35, 0.45, 0.82))), 0.0, 1.0);
  float height = clamp((position_m.z - road_m) / 6.0, 0.0, 1.0);
  color = color * (0.66 + 0.38 * sun + 0.14 * height) + 0.09 * height;
  vec2 per_pixel = max(fwidth(cell), vec2(1e-6));
  vec2 pixels = abs(fract(cell - 0.5) - 0.5) / per_pixel;
  float line = 1.0 - clamp(min(pixels.x, pixels.y) - 0.25, 0.0, 1.0);
  float visible = clamp((1.0 / max(per_pixel.x, per_pixel.y) - 2.0) / 8.0, 0.0, 1.0);
  color *= 1.0 - 0.34 * line * visible;
  float far = clamp(distance(cameraPosition, position_m) / clear_m - 1.0, 0.0, 0.25);
  gl_FragColor = vec4(mix(color, haze, far), 1.0);
}`;

// A material with a colour for each label; `setColors` takes RGB (0 to 255) by label, `haze` is the colour of
// far away: of what is farther than the uniform `clear_m`.
export class VoxelMaterial extends ShaderMaterial {
  constructor(road_m) {
    const palette = new DataTexture(new Uint8Array(256 * 4).fill(255), 256, 1);
    palette.needsUpdate = true;
    super({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms: { palette: { value: palette }, haze: { value: new Color() }, road_m: { value: road_m }, clear_m: { value: 50 } } });
  }

  setColors(colors, haze) {
    const palette = this.uniforms.palette.value;
    colors.forEach((color, label) => palette.image.data.set(color, label * 4));
    palette.needsUpdate = true;
    this.uniforms.haze.value.setRGB(...haze.map(part => part / 255));
  }
}

// The geometry of the visible cells of a volume.
export function voxelGeometry(grid, labels, visible) {
  const mesh = vertices(grid, faces(grid, labels, visible), OVERLAP_M), geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(mesh.position, 3));
  geometry.setAttribute("normal", new BufferAttribute(mesh.normal, 3, true));
  geometry.setAttribute("place", new BufferAttribute(mesh.place, 2));
  geometry.setAttribute("label", new BufferAttribute(mesh.label, 1));
  geometry.setIndex(new BufferAttribute(mesh.index, 1));
  return geometry;
}
