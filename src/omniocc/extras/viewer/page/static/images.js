// The camera images and the panorama, in which a pixel is chosen by the pointer or by the arrow keys.

import { imageUrl, page } from "omniocc/data.js";
import { at, css, make, swatch } from "omniocc/dom.js";
import { panoramaDirection, rayOf } from "omniocc/lens.js";

const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class Images {
  // `choose(ray)` is called with { origin, direction, name, ... } or null for a pixel without a ray; `look(camera)` when
  // the 3D views are to look from a camera.
  constructor(choose, look) {
    Object.assign(this, { choose, look, chosen: null, figures: [] });
  }

  // Show a frame; a chosen pixel stays chosen.
  async show(frame) {
    const facts = page.frames[frame], { cameras, order } = page.rigs[facts.rig] ?? { cameras: [], order: [] };
    const shape = JSON.stringify([facts.rig, facts.panoramas.map(({ of }) => of)]);
    if (shape !== this.shape) this.build(cameras, order, facts.panoramas);
    this.shape = shape;
    at("cameras").hidden = !this.figures.length;
    const sources = [...facts.images, ...facts.panoramas.map(({ image }) => image)];
    this.figures.forEach(({ image }, number) => { image.src = imageUrl(sources[number]); });
    await this.again();
  }

  build(cameras, order, panoramas) {
    const own = cameras.map((camera, number) => this.camera(camera, number));
    const around = panoramas.map((panorama, place) => this.panorama(panorama, cameras.length + place));
    at("images").replaceChildren(...order.map(number => own[number].figure));
    at("panoramas").replaceChildren(...around.map(({ figure }) => figure), ...(around.length ? [rangeBar()] : []));
    this.figures = [...own, ...around];
    this.mark();
  }

  // Ask for the ray of the chosen pixel once more.
  async again() {
    if (this.chosen) await this.at(this.chosen);
  }

  forget() {
    this.chosen = null;
    this.mark();
  }

  camera(camera, number) {
    const { figure, image, mark } = this.picture(camera.name, (across, down) => this.at({ number, across, down }), [camera.width, camera.height]);
    const look = make("button", { class: "from", title: `Look at the voxels from the camera ${camera.name}`, "aria-label": `Look from the camera ${camera.name}` }, "3D");
    look.addEventListener("click", () => this.look(camera));
    figure.append(look);
    return { figure, image, mark, camera };
  }

  panorama(facts, number) {
    const name = `range, ${facts.of !== "true" && page.runs.length === 1 ? "predicted" : facts.of}`;
    const picture = this.picture(`${name}: rear, left, front, right, rear`, (across, down) => this.at({ number, across, down }), [facts.width, facts.height]);
    picture.image.classList.add("pixels");
    return { ...picture, facts };
  }

  picture(name, chosen, [width, height]) {
    const image = make("img", { alt: name, draggable: false, width, height });
    const mark = make("span", { class: "cross", hidden: true });
    const press = make("div", { class: "press", tabIndex: 0, role: "application", "aria-label": `${name}: click a pixel, or move it with the arrow keys` }, image, mark);
    press.addEventListener("click", event => {
      const box = image.getBoundingClientRect();
      chosen((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
    });
    press.addEventListener("keydown", event => {
      const step = KEYS[event.key];
      if (event.shiftKey || !(step || event.key === "Enter")) return;
      event.preventDefault();
      event.stopPropagation();
      const now = mark.hidden ? [0.5, 0.5] : [parseFloat(mark.style.left) / 100, parseFloat(mark.style.top) / 100];
      const by = mark.hidden || !step ? [0, 0] : step;
      chosen(...[0, 1].map(axis => Math.min(Math.max(now[axis] + by[axis] * 8 / [width, height][axis], 0), 0.9999)));
    });
    return { figure: make("figure", {}, press, make("figcaption", {}, name)), image, mark };
  }

  // Choose a place in an image, both coordinates from 0 to 1.
  async at(place) {
    this.chosen = place;
    this.mark();
    const { camera, facts } = this.figures[place.number] ?? {};
    if (facts) this.choose({ name: "panorama", origin: [0, 0, 0], direction: panoramaDirection(facts, place.across, place.down) });
    else if (camera) {
      const ray = await this.rayIn(camera, place);
      if (this.chosen === place) this.choose(ray); // the tables of a lens take time to load, and another may be chosen by now
    } else this.choose(null);
  }

  async rayIn(camera, { across, down }) {
    const u = across * camera.width - 0.5, v = down * camera.height - 0.5, ray = await rayOf(camera, u, v);
    return { ...ray, name: `${camera.name}, pixel ${Math.round(u)}, ${Math.round(v)}`, outside: ray === null };
  }

  mark() {
    this.figures.forEach(({ mark, facts }, number) => {
      const same = this.chosen && (number === this.chosen.number || (facts && this.figures[this.chosen.number]?.facts));
      mark.hidden = !same;
      if (same) Object.assign(mark.style, { left: `${100 * this.chosen.across}%`, top: `${100 * this.chosen.down}%` });
    });
  }

  // Colour the cross like the class that the ray hits.
  tint(rgb) {
    document.documentElement.style.setProperty("--cross", rgb ? css(rgb) : "#fff");
  }
}

// The colours of ranges, with the ranges at their places, and those of pixels without a range.
function rangeBar() {
  const { colors, ticks, sky, unknown } = page.ranges;
  const marks = ticks.map(({ range_m, place }) => make("span", { style: { left: `${100 * place}%` } }, `${range_m} m`));
  const bar = make("div", { class: "bar", style: { background: `linear-gradient(to right, ${colors.map(css).join(", ")})` } });
  return make("div", { class: "ranges" }, make("div", { class: "scale" }, bar, ...marks), make("span", {}, swatch(sky), "sky"), make("span", {}, swatch(unknown), "unknown"));
}
