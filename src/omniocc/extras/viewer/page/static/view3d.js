// Several views side by side in one canvas, all seen by one camera that the pointer and the keyboard move.

import { Group, Mesh, PerspectiveCamera, Scene, Vector3, WebGLRenderer, WebGLRenderTarget } from "three";
import { OrbitControls } from "three";
import { car as carOf, clear, outline } from "omniocc/extras.js";
import { VoxelMaterial, voxelGeometry } from "omniocc/voxels.js";

const HORIZONTAL_DEG = 58, WIDEST_DEG = 60; // field of view: horizontally, and at most vertically
const TURN_RAD = 0.08;

export class View3d {
  // `canvas` fills its parent; `reach_m` is the distance from the middle to the end of the largest grid.
  constructor(canvas, { car, reach_m }) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.renderer.setClearColor(0, 0);
    this.renderer.autoClear = false;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(40, 1, 0.1, 40 * reach_m);
    this.camera.up.set(0, 0, 1);
    this.reach = reach_m;
    this.scale = reach_m / 25.6;
    this.materials = { classes: new VoxelMaterial(car.road_z_m), kinds: new VoxelMaterial(car.road_z_m) };
    this.extras = new Group();
    this.ray = new Group();
    this.outlines = new Map();
    this.car = carOf(car.boxes);
    this.carRoad = car.road_z_m;
    this.scene.add(this.ray, this.extras.add(this.car));
    this.views = [];
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.14, zoomToCursor: false, maxDistance: 12 * reach_m, minDistance: 0.5 });
    this.controls.addEventListener("change", () => this.invalidate());
    this.look("behind");
    new ResizeObserver(() => this.invalidate()).observe(canvas);
    canvas.addEventListener("webglcontextrestored", () => this.invalidate());
  }

  // Show as many views; each gets what `setVolume` gives it.
  setCount(count) {
    while (this.views.length > count) this.remove(this.views.pop());
    while (this.views.length < count) {
      const mesh = new Mesh(undefined, this.materials.classes);
      mesh.frustumCulled = false;
      mesh.visible = false;
      this.scene.add(mesh);
      this.views.push({ mesh, grid: null });
    }
    this.invalidate();
  }

  // Put the car on the road, whose height in the ego frame differs between rigs, and shade voxels from there.
  setRoad(road_m) {
    this.car.position.z = road_m - this.carRoad;
    for (const material of Object.values(this.materials)) material.uniforms.road_m.value = road_m;
    this.invalidate();
  }

  remove({ mesh }) {
    mesh.geometry.dispose();
    this.scene.remove(mesh);
  }

  // Show the visible cells of a volume in a view; null empties it. `kinds`: labels are kinds of differences.
  setVolume(number, volume, visible, kinds) {
    const view = this.views[number];
    view.mesh.geometry.dispose();
    view.grid = volume?.grid ?? null;
    view.mesh.geometry = volume ? voxelGeometry(volume.grid, volume.labels, visible) : new Mesh().geometry;
    view.mesh.material = kinds ? this.materials.kinds : this.materials.classes;
    this.invalidate();
  }

  setColors(classes, kinds, haze, line) {
    this.materials.classes.setColors(classes, haze);
    this.materials.kinds.setColors(kinds, haze);
    for (const lines of this.outlines.values()) this.extras.remove(lines);
    this.outlines.clear();
    this.line = line;
    this.invalidate();
  }

  // Replace what is drawn of the chosen ray.
  setRay(objects) {
    clear(this.ray);
    if (objects.length) this.ray.add(...objects);
    this.invalidate();
  }

  triangles() {
    return this.views.map(({ mesh }) => (mesh.geometry.index?.count ?? 0) / 3);
  }

  // Move the camera: "behind", "above", "car" (from the car's roof), or { eye, target } in the ego frame.
  look(where) {
    const s = this.scale;
    const places = {
      behind: { eye: [-27 * s, 0, 21 * s], target: [0.5 * s, 0, -3 * s] },
      above: { eye: [-0.01, 0, 1.06 * this.reach / this.narrowest()], target: [0, 0, -2] },
      car: { eye: [-1.2, 0, 0.4], target: [4, 0, -0.4] },
    };
    const { eye, target } = places[where] ?? where;
    this.controls.enableDamping = false; // drop what is left of a turn
    this.controls.update();
    this.controls.enableDamping = true;
    this.camera.position.set(...eye);
    this.controls.target.set(...target);
    this.controls.update();
    this.invalidate();
  }

  // The tangent of half the field of view of one view, horizontally or vertically, whichever is less.
  narrowest() {
    this.fit(this.canvas.clientWidth / Math.max(this.views.length, 1), this.canvas.clientHeight || 1);
    return Math.tan(this.camera.fov * Math.PI / 360) * Math.min(this.camera.aspect, 1);
  }

  // Turn by steps to the left and up, and come nearer by steps.
  turn(left, up, nearer) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const flat = Math.hypot(offset.x, offset.y), azimuth = Math.atan2(offset.y, offset.x) - left * TURN_RAD;
    const elevation = Math.min(Math.max(Math.atan2(offset.z, flat) + up * TURN_RAD, -1.5), 1.5);
    const distance = offset.length() * 0.9 ** nearer, reach = distance * Math.cos(elevation);
    offset.set(reach * Math.cos(azimuth), reach * Math.sin(azimuth), distance * Math.sin(elevation));
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.invalidate();
  }

  // Return { number, origin, direction } of the view and the ray under a point of the page; null beside the views.
  pointed(x, y) {
    const box = this.canvas.getBoundingClientRect(), width = box.width / this.views.length;
    const number = Math.floor((x - box.left) / width);
    if (!(number >= 0 && number < this.views.length && y >= box.top && y <= box.bottom)) return null;
    this.fit(width, box.height);
    const across = ((x - box.left) / width - number) * 2 - 1, down = ((y - box.top) / box.height) * 2 - 1;
    const direction = new Vector3(across, -down, 0.5).unproject(this.camera).sub(this.camera.position).normalize();
    return { number, origin: this.camera.position.toArray(), direction: direction.toArray() };
  }

  invalidate() {
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = undefined;
      this.controls.update();
      this.draw();
    });
  }

  draw() {
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight, count = this.views.length;
    if (!width || !height || !count) return;
    const ratio = Math.min(window.devicePixelRatio, 2);
    if (this.renderer.getPixelRatio() !== ratio) this.renderer.setPixelRatio(ratio);
    if (this.canvas.width !== Math.floor(width * ratio) || this.canvas.height !== Math.floor(height * ratio)) this.renderer.setSize(width, height, false);
    this.fit(width / count, height);
    const clear_m = 1.3 * this.camera.position.distanceTo(this.controls.target) + 5;
    for (const material of Object.values(this.materials)) material.uniforms.clear_m.value = clear_m;
    this.renderer.setScissorTest(true);
    for (let number = 0; number < count; number++) {
      const place = [Math.round(width * number / count), 0, Math.ceil(width / count), height];
      this.renderer.setViewport(...place);
      this.renderer.setScissor(...place);
      this.renderer.clear();
      this.only(number);
      this.renderer.render(this.scene, this.camera);
    }
  }

  fit(width, height) {
    const aspect = width / height, half = Math.tan(HORIZONTAL_DEG * Math.PI / 360) / aspect;
    this.camera.aspect = aspect;
    this.camera.fov = Math.min(2 * Math.atan(half) * 180 / Math.PI, WIDEST_DEG);
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
  }

  only(number) {
    this.views.forEach(({ mesh }, each) => { mesh.visible = each === number; });
    const grid = this.views[number].grid;
    if (grid && !this.outlines.has(grid)) {
      this.outlines.set(grid, outline(grid, this.line));
      this.extras.add(this.outlines.get(grid));
    }
    for (const [each, lines] of this.outlines) lines.visible = each === grid;
  }

  // Return one view alone as pixels: { width, height, rgba (rows from the bottom), eye, target, fov_deg }; alpha is 0
  // where there is no voxel. Nothing but voxels is drawn.
  snapshot(number, width, height) {
    const target = new WebGLRenderTarget(width, height), rgba = new Uint8Array(width * height * 4);
    const hidden = [this.extras, this.ray];
    for (const group of hidden) group.visible = false;
    this.fit(width, height);
    this.only(number);
    this.renderer.setScissorTest(false);
    this.renderer.setRenderTarget(target);
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    this.renderer.readRenderTargetPixels(target, 0, 0, width, height, rgba);
    this.renderer.setRenderTarget(null);
    target.dispose();
    for (const group of hidden) group.visible = true;
    this.invalidate();
    return { width, height, rgba, eye: this.camera.position.toArray(), target: this.controls.target.toArray(), fov_deg: this.camera.fov };
  }

  // Return the milliseconds that each of some frames takes while the camera turns, all views drawn to the end.
  measure(count) {
    const gl = this.renderer.getContext(), pixel = new Uint8Array(4), times = [];
    for (let frame = 0; frame < count; frame++) {
      const began = performance.now();
      this.turn(1, 0, 0);
      this.draw();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      times.push(performance.now() - began);
    }
    return times;
  }
}
