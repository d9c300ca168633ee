// What Python packed into the page (omniocc.extras.viewer.page.pack): facts as JSON, labels and tables compressed, images.

import { Grid } from "omniocc/grid.js";
import { FREE, UNKNOWN } from "omniocc/trace.js";

export const page = JSON.parse(document.getElementById("facts").textContent);
export const grids = page.grids.map(facts => new Grid(facts));

export const RIGHT = 1, WRONG = 2, MISSED = 3, HALLUCINATED = 4; // kinds of differences, as in `page.kinds`

const text = name => document.getElementById(name).textContent;
const KEPT = 48; // volumes kept decoded, each with a byte for every cell
const decoded = new Map();

// Return the bytes of a compressed block of the page; the last few are kept.
export function bytesOf(name) {
  const found = decoded.get(name) ?? inflate(text(name));
  decoded.delete(name);
  decoded.set(name, found);
  if (decoded.size > KEPT) decoded.delete(decoded.keys().next().value);
  return found;
}

async function inflate(base64) {
  const packed = Uint8Array.from(atob(base64), letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

export const imageUrl = image => `data:image/${image.format};base64,${text(image.block)}`;

// What can be shown in a view: truths, one for each grid, and for each run its prediction and its differences.
export const sources = listSources();

function listSources() {
  const used = page.grids.map((_, grid) => grid).filter(grid => page.frames.some(frame => frame.truth[grid] !== undefined));
  const found = used.map(grid => ({ key: `truth-${grid}`, kind: "truth", grid, title: used.length > 1 ? `truth, ${page.grids[grid].kind}` : "truth" }));
  page.runs.forEach((run, number) => {
    const title = page.runs.length > 1 ? run : "prediction";
    found.push({ key: `run-${number}`, kind: "run", run: number, title });
    if (used.length) found.push({ key: `differences-${number}`, kind: "differences", run: number, title: page.runs.length > 1 ? `differences, ${run}` : "differences" });
  });
  return found;
}

// The sources of the views at first: truth, prediction and differences of one run, or truth and the runs.
export function firstSources() {
  const truth = sources.filter(source => source.kind === "truth").slice(0, 1), runs = sources.filter(source => source.kind === "run");
  const differences = sources.filter(source => source.kind === "differences");
  return (runs.length > 1 ? [...truth, ...runs] : [...truth, ...runs, ...differences]).slice(0, 3).map(source => source.key);
}

// Return { grid, labels } of a source in a frame, or null where it has none. Labels of differences are kinds.
export async function volume(frame, source) {
  const facts = page.frames[frame];
  if (source.kind === "truth") return labelsOf(facts.truth[source.grid], source.grid);
  const prediction = facts.predictions[source.run];
  if (prediction === null) return null;
  if (source.kind === "run") return labelsOf(prediction.labels, prediction.grid);
  const [truth, predicted] = await Promise.all([labelsOf(facts.truth[prediction.grid], prediction.grid), labelsOf(prediction.labels, prediction.grid)]);
  return truth && { grid: truth.grid, truth: truth.labels, predicted: predicted.labels };
}

// Return [points, rays of the LiDAR, rays of cameras] of a cell of a frame's truth, each at most 255; null if not known.
export async function evidence(frame, grid, cell) {
  const block = page.frames[frame].evidence[grid];
  if (block === undefined) return null;
  const counts = await bytesOf(block);
  return [0, 1, 2].map(kind => counts[kind * grids[grid].cells + cell]);
}

const labelsOf = async (block, grid) => (block === undefined ? null : { grid: grids[grid], labels: await bytesOf(block) });

// Return the kind of difference of every cell whose true or predicted class is shown; 0 where both are free, where the
// truth is unknown, and elsewhere.
export function differences(truth, predicted, shown) {
  const kinds = new Uint8Array(truth.length);
  for (let cell = 0; cell < truth.length; cell++) {
    const right = truth[cell], said = predicted[cell];
    if (right === UNKNOWN || !(shown[right] || shown[said])) continue;
    kinds[cell] = kindOf(right, said);
  }
  return kinds;
}

function kindOf(truth, predicted) {
  if (truth === predicted) return truth === FREE ? 0 : RIGHT;
  if (truth === FREE) return HALLUCINATED;
  return predicted === FREE || predicted === UNKNOWN ? MISSED : WRONG;
}

// Return for each class how many cells are right, of another class than predicted, missed and hallucinated (of this
// class, where nothing or something else is), cells of unknown truth not counted.
export function countByClass(truth, predicted) {
  const counts = page.classes.map(() => ({ right: 0, wrong: 0, missed: 0, hallucinated: 0, confused: 0 }));
  for (let cell = 0; cell < truth.length; cell++) {
    const right = truth[cell], said = predicted[cell];
    if (right === UNKNOWN || (right === FREE && said === FREE)) continue;
    const kind = kindOf(right, said);
    if (kind === RIGHT) counts[right].right++;
    else if (kind === HALLUCINATED) counts[said].hallucinated++;
    else if (kind === MISSED) counts[right].missed++;
    else {
      counts[right].wrong++;
      counts[said].confused++; // predicted as this class, but of another one
    }
  }
  return counts;
}

// Return how many cells have each class.
export function countCells(labels) {
  const counts = new Array(page.classes.length).fill(0);
  for (const label of labels) if (label < counts.length) counts[label]++;
  return counts;
}
