// What stands beside the images: the figures of the frame, the classes with their differences, and what the ray hits.

import { countByClass, countCells, page } from "omniocc/data.js";
import { at, css, make, meters, number, swatch } from "omniocc/dom.js";

const COUNTED = ["right", "wrong", "missed", "hallucinated"];

// A row for each class but free: whether it is shown, its colour and key, its IoU and its cells.
export class Classes {
  // `shown` has a 1 for each class that is shown, `kinds` for each kind of difference; `changed()` follows a change.
  constructor(shown, kinds, changed) {
    Object.assign(this, { shown, kinds, changed });
    this.rows = page.classes.map((facts, label) => (label === 0 ? null : this.row(facts, label)));
    this.unit = make("span", { class: "unit" });
    at("classes").append(make("div", { class: "columnheads" }, this.unit, make("span", {}, "cells")), ...this.rows.filter(Boolean).map(({ row }) => row));
    this.chips = page.kinds.map((facts, kind) => (kind === 0 ? null : this.chip(facts, kind)));
    if (page.runs.length) at("kinds").append(...this.chips.filter(Boolean).map(({ chip }) => chip));
    at("kinds").hidden = !page.runs.length || !page.frames.some(frame => Object.keys(frame.truth).length);
    at("all").addEventListener("click", () => this.setAll(1));
    at("none").addEventListener("click", () => this.setAll(0));
  }

  row({ name }, label) {
    const box = make("input", { type: "checkbox", checked: true }), color = swatch([0, 0, 0]), score = make("span", { class: "score" }), bar = make("span", { class: "stack" });
    box.addEventListener("change", () => this.toggle(label));
    const key = label <= 9 ? [make("kbd", {}, String(label))] : [];
    return { row: make("label", { class: "row" }, box, color, make("span", { class: "name" }, name, ...key), score, bar), box, color, score, bar };
  }

  chip({ name }, kind) {
    const box = make("input", { type: "checkbox", checked: true }), color = swatch([0, 0, 0]), count = make("small");
    box.addEventListener("change", () => { this.kinds[kind] = box.checked ? 1 : 0; this.changed(); });
    return { chip: make("label", { class: "chip" }, box, color, name, count), color, count };
  }

  toggle(label) {
    if (!this.rows[label]) return;
    this.shown[label] ^= 1;
    this.rows[label].box.checked = this.shown[label] === 1;
    this.changed();
  }

  setAll(value) {
    this.rows.forEach((row, label) => {
      if (!row) return;
      row.box.checked = value === 1;
      this.shown[label] = value;
    });
    this.changed();
  }

  setColors(classes, kinds) {
    this.rows.forEach((row, label) => { if (row) row.color.style.background = css(classes[label]); });
    this.chips.forEach((chip, kind) => { if (chip) chip.color.style.background = css(kinds[kind]); });
    COUNTED.forEach((name, kind) => document.documentElement.style.setProperty(`--${name}`, css(kinds[kind + 1])));
  }

  // Count a frame: truth and prediction, one of them alone, or nothing.
  count(truth, predicted) {
    if (truth && predicted) this.compare(countByClass(truth, predicted));
    else this.list(countCells(truth ?? predicted ?? []));
  }

  compare(counts) {
    this.unit.textContent = "IoU";
    const most = Math.max(...counts.map(count => count.right + count.wrong + count.missed + count.hallucinated), 1);
    this.rows.forEach((row, label) => {
      if (!row) return;
      const count = counts[label], union = count.right + count.wrong + count.missed + count.hallucinated + count.confused;
      row.score.textContent = union ? number(count.right / union, 2) : "\u2013";
      row.row.title = COUNTED.map(kind => `${count[kind]} ${page.kinds[COUNTED.indexOf(kind) + 1].name}`).join(", ") + `, ${count.confused} of other classes`;
      row.bar.replaceChildren(...COUNTED.map(kind => make("i", { class: kind, style: { width: `${100 * count[kind] / most}%` } })));
    });
    COUNTED.forEach((kind, place) => {
      const total = counts.reduce((sum, count) => sum + count[kind], 0);
      this.chips[place + 1].count.textContent = total.toLocaleString("en");
    });
  }

  list(counts) {
    this.unit.textContent = "fraction";
    const most = Math.max(...counts.slice(1), 1), total = counts.slice(1).reduce((sum, count) => sum + count, 0) || 1;
    this.rows.forEach((row, label) => {
      if (!row) return;
      row.score.textContent = `${(100 * counts[label] / total).toFixed(1)}%`;
      row.row.title = `${counts[label]} cells`;
      row.bar.replaceChildren(make("i", { class: "plain", style: { width: `${100 * counts[label] / most}%` } }));
    });
  }
}

// What the colours of differences say.
export function legend() {
  const names = COUNTED.map((kind, place) => make("span", {}, make("i", { class: `swatch ${kind}` }), page.kinds[place + 1].name));
  return make("p", { class: "legend" }, ...names);
}

// The figures of a frame: a row for each figure, for each run its value in this frame and the mean of all frames.
export function showFigures(frame) {
  const { predictions } = page.frames[frame], figures = page.figures.filter(({ key }) => predictions.some(found => Number.isFinite(found?.figures[key])));
  at("figures").closest("section").hidden = !figures.length;
  const several = page.runs.length > 1;
  const head = make("tr", {}, make("th", {}), ...page.runs.flatMap(run => [make("th", {}, several ? run : "this frame"), make("th", {}, several ? "mean" : `mean of ${page.frames.length} frames`)]));
  const rows = figures.map(({ key, name }) => make("tr", {}, make("td", {}, name), ...page.runs.flatMap((_, run) => [
    make("td", {}, number(predictions[run]?.figures[key])), make("td", { class: "mean" }, number(meanOf(key, run))),
  ])));
  at("figures").replaceChildren(make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows)));
}

function meanOf(key, run) {
  const values = page.frames.map(({ predictions }) => predictions[run]?.figures[key]).filter(Number.isFinite);
  return values.reduce((sum, value) => sum + value, 0) / values.length;
}

const counted = (count, name) => `${count < 255 ? count : "255 or more"} ${name}${count === 1 ? "" : "s"}`;

// What was measured of a true cell, in words; `counts` as of `evidence` in data.js.
export function measured(counts) {
  return counts ? `The true cell has ${counted(counts[0], "point")}; ${counted(counts[1], "LiDAR ray")} and ${counted(counts[2], "camera ray")} pass it.` : "";
}

// Why the first unknown cell on a ray is unknown, in words.
export function whyUnknown(counts) {
  if (!counts) return "";
  if (counts.every(count => count === 0)) return " No point is in the first of them, and no ray reaches it.";
  return ` The first has ${counted(counts[0], "point")}, ${counted(counts[1], "LiDAR ray")} and ${counted(counts[2], "camera ray")}: the labels leave it out.`;
}

// What a ray hits: [{ title, hit, color }] by source, and lines about it.
export function showReadout(name, rows, messages) {
  at("forget").hidden = !name;
  if (!name) {
    at("readout").replaceChildren(...messages.map(message => make("p", { class: "note" }, message)));
    return;
  }
  const first = rows.find(({ hit }) => hit && hit.label)?.hit;
  const lines = rows.map(({ title, hit, color }, place) => {
    if (!hit) return make("tr", {}, make("td", {}, title), make("td", { colSpan: 3 }, "no voxels"));
    const found = hit.label ? [swatch(color), page.classes[hit.label]?.name ?? `class ${hit.label}`] : ["nothing"];
    const off = place && first && hit.label ? `${hit.entry >= first.entry ? "+" : "\u2212"}${Math.abs(hit.entry - first.entry).toFixed(2)} m` : "";
    return make("tr", {}, make("td", {}, title), make("td", {}, ...found), make("td", {}, hit.label ? meters(hit.entry) : ""), make("td", { title: "Farther (+) or nearer (\u2212) than the first true cell" }, off));
  });
  const places = rows.filter(({ hit }) => hit?.label && hit.cell >= 0).map(({ title, hit, grid }) => make("p", { class: "note place" }, `${title}: ${placeOf(grid.center(hit.cell))}`));
  at("readout").replaceChildren(
    make("p", { class: "from" }, name), ...messages.map(message => make("p", { class: "note" }, message)),
    ...(lines.length ? [make("table", {}, make("tbody", {}, ...lines))] : []), ...places,
  );
}

// Where a point of the ego frame is, seen from the car.
function placeOf([x, y, z]) {
  const signed = z < 0 ? `\u2212${meters(-z)}` : meters(z);
  return `${meters(Math.abs(x))} ${x < 0 ? "behind" : "ahead"}, ${meters(Math.abs(y))} ${y < 0 ? "right" : "left"}, z ${signed}`;
}
