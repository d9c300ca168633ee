// The page: what is shown, and what keys and buttons change.

import { differences, evidence, firstSources, grids, page, sources, volume } from "omniocc/data.js";
import { at, make } from "omniocc/dom.js";
import { bar, cellMark } from "omniocc/extras.js";
import { Images } from "omniocc/images.js";
import { faces } from "omniocc/mesh.js";
import { Classes, legend, measured, showFigures, showReadout, whyUnknown } from "omniocc/panels.js";
import { Timeline } from "omniocc/timeline.js";
import { stopping, trace } from "omniocc/trace.js";
import { View3d } from "omniocc/view3d.js";

const NARROW = window.matchMedia("(max-width: 720px)"), DARK = window.matchMedia("(prefers-color-scheme: dark)");
const HINT = page.frames.some(frame => frame.images.length) ? "Click an image, or voxels." : "Click voxels.";
const KEYS = [
  ["arrow left, right", "frame before, next frame"], ["space", "play, pause"], ["w, W", "worst frame first: the next worst, back"],
  ["1 \u2026 9", "show or hide a class"], ["0", "all classes"], ["Shift + arrows", "turn"], ["+ \u2212", "nearer, farther"],
  ["b, a, v", "from behind, from above, from the car"], ["Tab", "next control"], ["c", "colours for colour-blind people"],
  ["d", "light or dark"], ["Esc", "forget the ray"], ["?", "this list"],
];

const state = { frame: 0, views: firstSources(), tab: 0, safe: false, theme: null, ray: null, drawn: Promise.resolve() };
const shown = new Uint8Array(256), kinds = new Uint8Array(256);
shown.fill(1, 1, page.classes.length);
kinds.fill(1, 1, page.kinds.length);

const view3d = start3d();
const images = new Images(setRay, camera => view3d?.look({ eye: camera.origin, target: camera.origin.map((value, axis) => value + 6 * camera.forward[axis]) }));
const classes = new Classes(shown, kinds, () => show());
const timeline = new Timeline(frame => show(frame));

function start3d() {
  const reach_m = Math.max(...page.grids.map(({ kind, bounds }) => (kind === "cylinder" ? bounds[0][1] : Math.max(...bounds.slice(0, 2).flat().map(Math.abs)))));
  try {
    return new View3d(at("canvas"), { car: page.car, reach_m });
  } catch (error) {
    at("hint").textContent = `No 3D: ${error.message}. Is WebGL 2 switched on in this browser?`;
    return null;
  }
}

const source = key => sources.find(each => each.key === key);
const visibleViews = () => (NARROW.matches ? state.views.slice(state.tab, state.tab + 1) : state.views);

// Draw a frame; drawing is one after the other, and frames that are no longer asked for are left out. A frame that
// cannot be drawn is an error on the console, not the end of the page.
function show(frame = state.frame) {
  state.frame = Math.min(Math.max(Math.trunc(frame) || 0, 0), page.frames.length - 1);
  timeline.show(state.frame);
  history.replaceState(null, "", `#frame=${state.frame}`);
  const asked = (state.asked = Symbol("asked"));
  state.drawn = state.drawn.catch(() => {}).then(() => (asked === state.asked ? draw() : undefined));
  return state.drawn;
}

async function draw() {
  const frame = state.frame;
  showFigures(frame);
  await Promise.all([drawVoxels(frame), images.show(frame), countFrame(frame)]);
  await drawRay();
}

async function drawVoxels(frame) {
  const keys = visibleViews(), volumes = await Promise.all(keys.map(key => volume(frame, source(key))));
  view3d?.setCount(keys.length);
  view3d?.setRoad(page.frames[frame].road_z_m);
  volumes.forEach((found, number) => {
    const compared = source(keys[number]).kind === "differences";
    const labels = found && (compared ? differences(found.truth, found.predicted, shown) : found.labels);
    view3d?.setVolume(number, found && { grid: found.grid, labels }, compared ? kinds : shown, compared);
  });
  heads(keys, volumes);
}

async function countFrame(frame) {
  const find = kind => sources.find(each => each.kind === kind && (each.run === undefined || each.run === timeline.run));
  const compared = find("differences") && (await volume(frame, find("differences")));
  const alone = find("run") ?? find("truth");
  if (compared) classes.count(compared.truth, compared.predicted);
  else classes.count(alone && (await volume(frame, alone))?.labels, null);
}

// Above each view what it shows, to be chosen; at phone width tabs instead.
function heads(keys, volumes) {
  at("tabs").replaceChildren(...state.views.map((key, number) => {
    const tab = make("button", { role: "tab", "aria-selected": number === state.tab, "aria-controls": "canvas" }, source(key).title);
    tab.addEventListener("click", () => { state.tab = number; show(); });
    return tab;
  }));
  const children = keys.map((key, number) => {
    const select = make("select", { "aria-label": `View ${number + 1} shows` }, ...sources.map(each => make("option", { value: each.key, selected: each.key === key }, each.title)));
    select.addEventListener("change", () => { state.views[NARROW.matches ? state.tab : number] = select.value; show(); });
    const explained = source(key).kind === "differences" ? [legend()] : [];
    return make("div", {}, select, ...explained, ...(volumes[number] ? [] : [make("span", { class: "none" }, "nothing in this frame")]));
  });
  at("heads").classList.toggle("single", NARROW.matches && sources.length <= state.views.length); // the tabs are enough
  const focused = [...at("heads").querySelectorAll("select")].indexOf(document.activeElement);
  at("heads").replaceChildren(...children);
  if (focused >= 0) at("heads").querySelectorAll("select")[focused]?.focus();
}

// Choose a ray; null forgets it.
async function setRay(ray) {
  state.ray = ray;
  await drawRay();
}

async function drawRay() {
  const { ray } = state;
  if (!ray || ray.outside || !ray.direction) {
    view3d?.setRay([]);
    images.tint(null);
    return showReadout(ray?.name, [], [ray ? "The lens does not see there, or the own car hides it." : HINT]);
  }
  const traced = sources.filter(each => each.kind !== "differences");
  const found = await Promise.all(traced.map(each => volume(state.frame, each)));
  const rows = traced.map((each, number) => {
    const hit = found[number] && trace(found[number].grid, found[number].labels, ray.origin, ray.direction, stopping(false));
    return { title: each.title, kind: each.kind, hit, grid: found[number]?.grid, color: hit && colors().classes[hit.label] };
  });
  images.tint(rows.find(({ hit }) => hit?.label)?.color);
  view3d?.setRay(rayObjects(ray, rows));
  return showReadout(ray.name, rows, await aboutTruth(rows[0]));
}

// Lines on the true cells along the ray: what was measured of the one that is hit, and why cells before it are unknown.
async function aboutTruth({ kind, hit, grid } = {}) {
  if (kind !== "truth" || !hit) return [];
  const counts = cell => (cell < 0 ? null : evidence(state.frame, grids.indexOf(grid), cell));
  const found = hit.label ? measured(await counts(hit.cell)) : "";
  const unknown = hit.unknown > 0.005 ? `${hit.unknown.toFixed(2)} m of it run through cells of unknown truth.${whyUnknown(await counts(hit.unknownCell))}` : "";
  return [found, unknown].filter(Boolean);
}

// The ray up to its last hit, and the outlines of the cells that are hit: true ones white, predicted ones yellow.
function rayObjects(ray, rows) {
  const ends = rows.filter(({ hit }) => hit && Number.isFinite(hit.entry)), objects = [];
  const length = Math.max(...ends.map(({ hit }) => hit.entry), 0);
  const end = ray.origin.map((value, axis) => value + length * ray.direction[axis]);
  if (length > 0 && !ray.hidden) objects.push(bar(ray.origin, end, 0xff3fa4, 0.12 * view3d.scale));
  for (const { hit, grid, kind } of ends) if (hit.cell >= 0) objects.push(cellMark(grid, hit.cell, kind === "truth" ? 0xffffff : 0xffd400));
  return objects;
}

// A click on voxels names the cell: the ray begins at the eye.
function pick(event) {
  const pointed = view3d?.pointed(event.clientX, event.clientY);
  if (!pointed) return;
  images.forget();
  const length = Math.hypot(...pointed.direction);
  setRay({ name: "from the viewpoint", origin: pointed.origin, direction: pointed.direction.map(value => value / length), hidden: true });
}

const colors = () => ({ classes: page.classes.map(each => (state.safe ? each.safe : each.rgb)), kinds: page.kinds.map(each => (state.safe ? each.safe : each.rgb)) });

function recolor() {
  const dark = state.theme ? state.theme === "dark" : DARK.matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  at("theme").textContent = dark ? "Light" : "Dark";
  at("safe").setAttribute("aria-pressed", state.safe);
  const found = colors();
  view3d?.setColors(found.classes, found.kinds, dark ? [24, 29, 38] : [246, 248, 251], dark ? 0x5a6678 : 0x9aa8ba);
  classes.setColors(found.classes, found.kinds);
  drawRay();
}

function forget() {
  images.forget();
  setRay(null);
}

function fromAddress() {
  const asked = new URLSearchParams(location.hash.slice(1)), named = asked.get("scene");
  if (named === null) return show(Number(asked.get("frame") ?? 0));
  const found = page.frames.findIndex(({ scene, frame }) => scene === named && Number(frame) === Number(asked.get("frame")));
  if (found < 0) at("hint").textContent = `Frame ${asked.get("frame")} of ${named} is not in this page.`;
  return show(Math.max(found, 0));
}

const onKey = {
  " ": () => timeline.toggle(), w: () => timeline.worst(1), W: () => timeline.worst(-1), 0: () => classes.setAll(1),
  b: () => view3d?.look("behind"), a: () => view3d?.look("above"), v: () => view3d?.look("car"),
  c: () => at("safe").click(), d: () => at("theme").click(), "?": () => at("keys").showModal(), Escape: forget,
  "+": () => view3d?.turn(0, 0, 1), "-": () => view3d?.turn(0, 0, -1),
};
const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

function pressed(event) {
  const { key, target } = event;
  if (event.ctrlKey || event.metaKey || event.altKey || at("keys").open || target.tagName === "SELECT") return;
  if (key === " " && /^(BUTTON|INPUT)$/.test(target.tagName) && target.type !== "range") return;
  const act = event.shiftKey && turns[key] ? () => view3d?.turn(...turns[key], 0)
    : { ArrowLeft: () => timeline.step(-1), ArrowRight: () => timeline.step(1) }[key] ?? onKey[key] ?? (/^[1-9]$/.test(key) ? () => classes.toggle(Number(key)) : null);
  if (!act) return;
  event.preventDefault();
  act();
}

function listen() {
  document.addEventListener("keydown", pressed);
  window.addEventListener("hashchange", fromAddress);
  NARROW.addEventListener("change", () => show());
  DARK.addEventListener("change", recolor);
  at("safe").addEventListener("click", () => { state.safe = !state.safe; recolor(); });
  at("theme").addEventListener("click", () => { state.theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark"; recolor(); });
  at("help").addEventListener("click", () => at("keys").showModal());
  at("forget").addEventListener("click", forget);
  for (const button of document.querySelectorAll("[data-look]")) button.addEventListener("click", () => view3d?.look(button.dataset.look));
  let down = null;
  at("canvas").addEventListener("pointerdown", event => { down = [event.clientX, event.clientY]; });
  at("canvas").addEventListener("click", event => { if (down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 4) pick(event); });
}

at("keylist").append(...KEYS.flatMap(([key, text]) => [make("dt", {}, key), make("dd", {}, text)]));
listen();
recolor();
fromAddress();
// for the tests in tests/browser, which compare with omniocc
window.omniocc = { page, grids, state, view3d, images, sources, volume, trace, stopping, faces, show, setRay, drawn: () => state.drawn };
