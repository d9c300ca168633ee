"use strict";
// Follows runs: asks the server that it comes from every few seconds, and draws what it answers. Texts of files are
// only ever set as text, never as HTML.

const EVERY_MS = 3000;
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d31", "#7a7a7a"]; // of Okabe and Ito
const FIRST_KEYS = ["train/loss", "val/rayiou", "val/lidar/rayiou", "val/depth/mae", "val/sketch/recall"];
const PLOT = { left: 64, right: 16, top: 12, bottom: 32, height: 360 };
const SVG = "http://www.w3.org/2000/svg";

const chosen = new Map(); // id of a run: its details
let touched = false; // whether the user has chosen runs
let images = ""; // what the images shown are of

const at = (id) => document.getElementById(id);

function element(name, text = "", attributes = {}) {
  const made = document.createElement(name);
  made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

async function ask(path, query = {}) {
  const answer = await fetch(`${path}?${new URLSearchParams(query)}`);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

function color(id) {
  return COLORS[[...chosen.keys()].indexOf(id) % COLORS.length];
}

function row(run) {
  const box = element("input", "", { type: "checkbox", "aria-label": `show curves of ${run.id}` });
  box.checked = chosen.has(run.id);
  box.addEventListener("change", () => {
    touched = true;
    if (box.checked) chosen.set(run.id, null);
    else chosen.delete(run.id);
    refreshChosen();
  });
  const cells = [element("td"), element("td", run.id, { class: "name" }), element("td", run.state)];
  cells[0].append(box);
  if (run.problem) cells[1].append(element("div", run.problem, { class: "problem" }));
  const steps = element("td");
  if (run.steps !== null) steps.append(element("progress", "", { max: run.steps, value: run.step }), " ");
  steps.append(run.steps === null ? `${run.step}` : `${run.step} of ${run.steps}`);
  const score = run.score === null ? "" : `${run.score[0]} ${run.score[1].toPrecision(3)}`;
  cells.push(steps, element("td", run.left), element("td", score), element("td", `${run.changed} ago`));
  const line = element("tr");
  line.append(...cells);
  return line;
}

async function refreshRuns() {
  const { runs, jobs } = await ask("/api/runs");
  if (!touched) {
    const active = runs.filter((run) => run.state === "in progress");
    const first = (active.length ? active : runs.slice(0, 1)).map((run) => run.id);
    for (const id of [...chosen.keys()]) if (!first.includes(id)) chosen.delete(id);
    for (const id of first) if (!chosen.has(id)) chosen.set(id, null);
  }
  for (const id of [...chosen.keys()]) if (!runs.some((run) => run.id === id)) chosen.delete(id);
  const focused = document.activeElement?.getAttribute("aria-label");
  at("runs").replaceChildren(...runs.map(row));
  if (focused) [...document.querySelectorAll("#runs input")].find((box) => box.getAttribute("aria-label") === focused)?.focus();
  at("empty").hidden = runs.length > 0;
  at("jobs").replaceChildren(...jobs.map(({ job, status }) => element("li", `${job}: ${status}`)));
}

async function refreshChosen() {
  await Promise.all([...chosen.keys()].map(async (id) => {
    const found = await ask("/api/run", { id });
    if (chosen.has(id)) chosen.set(id, found);
  }));
  showKeys();
  plot();
  showImages();
}

function showKeys() {
  const known = new Set([...chosen.values()].flatMap((run) => Object.keys(run?.curves ?? {})));
  const keys = [...FIRST_KEYS.filter((key) => known.has(key)), ...[...known].filter((key) => !FIRST_KEYS.includes(key)).sort()];
  const select = at("key"), before = select.value;
  if (keys.join("\n") === [...select.options].map((option) => option.value).join("\n")) return;
  select.replaceChildren(...keys.map((key) => element("option", key, { value: key })));
  if (known.has(before)) select.value = before;
}

function ticks(low, high, count) {
  const raw = (high - low) / count || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= raw);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + step * 1e-9; value += step) found.push(value);
  return found;
}

function shape(name, attributes, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

function plot() {
  const key = at("key").value, logarithmic = at("log").checked;
  const width = Math.max(240, at("plot").clientWidth);
  at("plot").setAttribute("viewBox", `0 0 ${width} ${PLOT.height}`);
  const scale = (value) => (logarithmic ? Math.log10(value) : value);
  const curves = [...chosen].map(([id, run]) => [id, (run?.curves[key] ?? []).filter(([, value]) => !logarithmic || value > 0)]);
  const points = curves.flatMap(([, curve]) => curve);
  const parts = [];
  if (points.length) {
    const steps = points.map(([step]) => step), values = points.map(([, value]) => scale(value));
    const [first, last] = [Math.min(...steps), Math.max(...steps, Math.min(...steps) + 1)];
    const pad = (Math.max(...values) - Math.min(...values)) * 0.05 || Math.abs(values[0]) * 0.05 || 1;
    const [low, high] = [Math.min(...values) - pad, Math.max(...values) + pad];
    const x = (step) => PLOT.left + ((step - first) / (last - first)) * (width - PLOT.left - PLOT.right);
    const y = (value) => PLOT.height - PLOT.bottom - ((value - low) / (high - low)) * (PLOT.height - PLOT.top - PLOT.bottom);
    for (const value of ticks(low, high, 6)) {
      parts.push(shape("line", { class: "axis", x1: PLOT.left, x2: width - PLOT.right, y1: y(value), y2: y(value) }));
      const text = (logarithmic ? 10 ** value : value).toPrecision(3).replace(/\.?0+$/, "");
      parts.push(shape("text", { x: PLOT.left - 8, y: y(value) + 4, "text-anchor": "end" }, text));
    }
    for (const step of ticks(first, last, width / 100)) {
      parts.push(shape("text", { x: x(step), y: PLOT.height - 10, "text-anchor": "middle" }, `${step}`));
    }
    for (const [id, curve] of curves) {
      const places = curve.map(([step, value]) => `${x(step).toFixed(1)},${y(scale(value)).toFixed(1)}`);
      parts.push(shape("polyline", { class: "curve", stroke: color(id), points: places.join(" ") }));
      for (const [k, place] of curve.length <= 40 ? places.entries() : []) {
        const [cx, cy] = place.split(","), dot = shape("circle", { cx, cy, r: 3, fill: color(id) });
        dot.append(shape("title", {}, `${id}: step ${curve[k][0]}, ${curve[k][1]}`));
        parts.push(dot);
      }
    }
  }
  at("plot").replaceChildren(...parts);
  at("legend").replaceChildren(...curves.map(([id, curve]) => {
    const line = element("span", "", { class: "line" }), entry = element("li");
    line.style.background = color(id);
    entry.append(line, curve.length ? `${id}: ${curve[curve.length - 1][1].toPrecision(4)}` : `${id}: no values yet`);
    return entry;
  }));
}

function showImages() {
  const names = [...chosen].flatMap(([id, run]) => (run?.images ?? []).map((name) => [id, name]));
  if (names.join("\n") === images) return; // an image is drawn once, under one name
  images = names.join("\n");
  at("images").replaceChildren(...names.map(([id, name]) => {
    const figure = element("figure");
    const image = element("img", "", { src: `/image?${new URLSearchParams({ id, name })}`, alt: name, loading: "lazy" });
    figure.append(image, element("figcaption", `${id}: ${name}`));
    return figure;
  }));
}

async function refresh() {
  if (!document.hidden) {
    try {
      await refreshRuns();
      await refreshChosen();
      at("news").textContent = `as of ${new Date().toLocaleTimeString()}`;
    } catch (error) {
      at("news").textContent = `no answer (${error.message}); is the server still running?`;
    }
  }
  setTimeout(refresh, EVERY_MS);
}

at("key").addEventListener("change", plot);
at("log").addEventListener("change", plot);
addEventListener("resize", plot);
refresh();
